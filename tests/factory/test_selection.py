"""Which frames are taken, which of them test, and what is said when a split stays empty."""

import json
import sys
from itertools import pairwise

from simnfnd.command import main
from simnfnd.factory.config import from_mapping
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.selection import choose_frames, split_frames, split_warnings
from tests.factory.cli_frames import FAST, ground, write_frame


def settings(**groups):
    return from_mapping({"scenes": {"kind": "flsea", "root": "x"}, **groups})


def found(**scenes: int) -> tuple[FrameRef, ...]:
    return tuple(
        FrameRef("sea", scene, f"{n:04d}") for scene, count in scenes.items() for n in range(count)
    )


def warnings(found_, /, **groups) -> tuple[str, ...]:
    config = settings(**groups)
    return split_warnings(split_frames(choose_frames(found_, config), config), config)


def test_total_counts_all_scenes_and_limit_each():
    frames = found(a=40, b=40, c=40)
    assert len(choose_frames(frames, settings(frames={"limit": 5}))) == 15
    chosen = choose_frames(frames, settings(frames={"total": 6}))
    assert len(chosen) == 6
    assert [ref.scene for ref in chosen] == ["a", "a", "b", "b", "c", "c"]
    assert len(choose_frames(frames, settings(frames={"total": 6, "limit": 1}))) == 3


def test_a_larger_total_keeps_the_frames_of_a_smaller_one():
    frames = found(a=13, b=70, c=5)
    chosen = [set(choose_frames(frames, settings(frames={"total": n}))) for n in range(1, 90)]
    assert all(few <= more for few, more in pairwise(chosen))
    assert [len(one) for one in chosen] == [*range(1, 89), 88]


def test_a_split_that_stays_empty_is_told_with_one_that_works():
    few = found(flatiron=3, pier=2, reef=2)
    (lost, empty) = warnings(few, split={"test": ["u_canyon", "coral_*"]})
    assert "u_canyon, coral_*" in lost
    offered = empty.partition("split.test=[] ")[2].partition("split.test=[")[2].rstrip("]")
    assert empty.startswith("the test split is empty")
    assert warnings(few, split={"test": offered.split(",")}) == ()
    assert warnings(few, split={"test": []}) == ()
    (lost,) = warnings(few, split={"test": ["pier", "u_canyon"]})
    assert lost == "split.test: u_canyon: no scene of that name here"
    (empty,) = warnings(few, split={"test": ["*"]})
    assert empty.startswith("the train split is empty")
    (empty,) = warnings(found(pool=9))
    assert "one scene, pool" in empty


def test_a_partial_download_without_test_scenes_is_told_first_and_last(
    monkeypatch, tmp_path, capfd
):
    for scene in ("canyons/flatiron", "red_sea/sub_pier"):
        write_frame(tmp_path / "flsea", "1623304454176560", ground(), scene)
    words = [
        "experiment=simnfnd",
        f"scenes.root={tmp_path / 'flsea'}",
        f"dataset.dir={tmp_path / 'o'}",
    ]
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    assert main(["make", *words, *FAST, "scheduler.backend=serial"]) == 0
    lines = capfd.readouterr().err.splitlines()
    told = [number for number, line in enumerate(lines) if "the test split is empty" in line]
    assert len(told) == 2
    assert told[1] == len(lines) - 1
    assert any("u_canyon, coral_table_loop" in line for line in lines)
    manifest = json.loads((tmp_path / "o/manifest.json").read_text())
    assert [shard["split"] for shard in manifest["shards"]] == ["train"]
    assert main(["plan", *words[:2], *FAST]) == 0
    assert "the test split is empty" in capfd.readouterr().err
