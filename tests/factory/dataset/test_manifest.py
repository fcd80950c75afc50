"""manifest.json, and manifest.jsonl: what a run settled since then, whatever became of it."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simnfnd.factory.dataset.format.manifest import (
    Additions,
    Manifest,
    ShardInfo,
    damage,
    load_manifest,
    save_manifest,
)
from simnfnd.factory.errors import FactoryError
from tests.factory.dataset.some_shards import dataset

START = Manifest("c0ffee", "simnfnd 0", {"seed": 1})


def info(number: int, **changes: object) -> ShardInfo:
    path = f"train/shard-{number:05d}.h5"
    return replace(ShardInfo(path, "train", 4, 1000, "0" * 64, "plan"), **changes)  # type: ignore[arg-type]


def begun(folder: Path, part: str = "") -> Additions:
    """A manifest of shards 0 to 2, and nothing added."""
    folder.mkdir(parents=True, exist_ok=True)
    shards = {info(n).path: info(n) for n in range(3)}
    save_manifest(folder, replace(START, shards=shards), part)
    return Additions(folder, part)


def shards(folder: Path, part: str = "") -> dict[str, ShardInfo]:
    manifest = load_manifest(folder, part)
    assert manifest is not None
    return dict(manifest.shards)


@pytest.mark.parametrize("part", ["", "1-of-3"])
def test_what_is_added_counts_at_once_and_is_gone_once_it_is_saved(
    tmp_path: Path, part: str
) -> None:
    added = begun(tmp_path, part)
    added.note(info(3).path, info(3, failed=("reef/alpha/1",)))
    added.note(info(1).path, info(1, samples=7))
    added.note(info(0).path, None)
    found = shards(tmp_path, part)
    assert sorted(found) == [info(n).path for n in (1, 2, 3)]
    assert found[info(1).path].samples == 7
    assert found[info(3).path].failed == ("reef/alpha/1",)
    save_manifest(tmp_path, replace(START, shards=found), part)
    assert shards(tmp_path, part) == found
    assert len(os.listdir(tmp_path)) == 1


def test_additions_to_an_older_manifest_are_left_alone(tmp_path: Path) -> None:
    """The run was killed after it wrote manifest.json and before it removed manifest.jsonl."""
    added = begun(tmp_path)
    added.note(info(3).path, info(3))
    old = (tmp_path / "manifest.jsonl").read_bytes()
    save_manifest(tmp_path, START)
    (tmp_path / "manifest.jsonl").write_bytes(old)
    assert shards(tmp_path) == {}


@given(cut=st.floats(0, 1), junk=st.binary(max_size=6))
def test_a_line_that_a_crash_has_spoilt_costs_itself_and_what_follows(
    tmp_path_factory: pytest.TempPathFactory, cut: float, junk: bytes
) -> None:
    folder = tmp_path_factory.getbasetemp() / "spoilt"
    if not folder.exists():
        added = begun(folder)
        for number in range(3, 8):
            added.note(info(number).path, info(number))
        (folder / "whole").write_bytes((folder / "manifest.jsonl").read_bytes())
    whole = (folder / "whole").read_bytes()
    at = int(cut * len(whole))
    (folder / "manifest.jsonl").write_bytes(whole[:at] + junk)
    found = sorted(shards(folder))
    good = max(0, whole[:at].count(b"\n") - 1)
    if whole[: at + len(junk)] == whole[:at] + junk:
        good = max(0, whole[: at + len(junk)].count(b"\n") - 1)
    assert found == [info(n).path for n in range(3 + good)]


@pytest.mark.parametrize("path", ["../secret.h5", "/etc/passwd", "test/shard-00000.h5"])
def test_nothing_elsewhere_can_be_added(tmp_path: Path, path: str) -> None:
    added = begun(tmp_path)
    added.note(info(3).path, info(3))
    file = tmp_path / "manifest.jsonl"
    file.write_bytes(file.read_bytes().replace(info(3).path.encode(), path.encode()))
    assert sorted(shards(tmp_path)) == [info(n).path for n in range(3)]


def test_a_pipe_in_its_place_stops_nobody(tmp_path: Path) -> None:
    begun(tmp_path)
    os.mkfifo(tmp_path / "manifest.jsonl")
    assert len(shards(tmp_path)) == 3


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    added = begun(tmp_path)
    (tmp_path / "manifest.jsonl").mkdir()
    with pytest.raises(FactoryError, match=r"dataset\.dir: cannot write .*manifest\.jsonl"):
        added.note(info(3).path, info(3))


def test_manifest_reads_back_and_its_bytes_do_not_depend_on_order(tmp_path: Path) -> None:
    manifest = dataset(tmp_path)
    text = (tmp_path / "manifest.json").read_bytes()
    assert load_manifest(tmp_path) == manifest
    backwards = replace(manifest, shards=dict(reversed(list(manifest.shards.items()))))
    save_manifest(tmp_path, backwards)
    assert (tmp_path / "manifest.json").read_bytes() == text
    document = json.loads(text)
    assert document["totals"]["train"] == {
        "samples": 8,
        "shards": 2,
        "bytes": sum((tmp_path / f"train/shard-0000{k}.h5").stat().st_size for k in (0, 1)),
    }
    for shard in document["shards"]:
        assert damage(tmp_path, ShardInfo(**{**shard, "failed": ()})) is None


@pytest.mark.parametrize(
    "path",
    ["../secret.h5", "/etc/passwd", "train/../../x.h5", "test/shard-00000.h5", "train/x.txt"],
)
def test_a_manifest_that_names_files_elsewhere_is_refused(tmp_path: Path, path: str) -> None:
    dataset(tmp_path)
    document = json.loads((tmp_path / "manifest.json").read_text())
    train = next(shard for shard in document["shards"] if shard["split"] == "train")
    train["path"] = path
    (tmp_path / "manifest.json").write_text(json.dumps(document))
    with pytest.raises(FactoryError, match=r"manifest\.json: damaged"):
        load_manifest(tmp_path)


@given(cut=st.floats(0, 1), junk=st.binary(max_size=5))
def test_a_damaged_manifest_is_one_clear_line(
    tmp_path_factory: pytest.TempPathFactory, cut: float, junk: bytes
) -> None:
    folder = tmp_path_factory.getbasetemp() / "damaged-manifest"
    if not folder.exists():
        dataset(folder)
        (folder / "whole").write_bytes((folder / "manifest.json").read_bytes())
    whole = (folder / "whole").read_bytes()
    at = int(cut * len(whole))
    (folder / "manifest.json").write_bytes(whole[:at] + junk + whole[at + len(junk) :])
    try:
        load_manifest(folder)
        said = "run again"
    except FactoryError as error:
        said = str(error)
    assert "\n" not in said
    assert "run again" in said
