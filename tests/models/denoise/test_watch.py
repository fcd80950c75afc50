"""`simnfnd denoise --watch`: whole files once, as they come."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.factory.errors import FactoryError
from simnfnd.models.denoise import command
from simnfnd.models.denoise.inputs import Item
from simnfnd.models.denoise.watch import Watched, watch
from tests.models.adapt.scenes import noisy, scene, write
from tests.models.denoise.halving import Halving, main
from tests.models.recordings.recording_files import pings, write_aris, write_oculus

PNG = cv2.imencode(".png", np.full((30, 40), 80, np.uint8))[1].tobytes()


def names(watched: Watched) -> list[str]:
    return [item.relative.as_posix() for item in watched.look()]


def age(path: Path, seconds: float) -> None:
    changed = path.stat().st_mtime - seconds
    os.utime(path, (changed, changed))


def test_a_file_is_given_out_once_when_it_has_stopped_growing(tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    (folder / "deep").mkdir(parents=True)
    watched = Watched(folder, out)
    path = folder / "deep" / "a.png"
    path.write_bytes(PNG[:20])
    (folder / ".b.png").write_bytes(PNG)
    (folder / "notes.txt").write_bytes(b"words")
    assert names(watched) == []
    path.write_bytes(PNG[:40])
    assert names(watched) == []
    path.write_bytes(PNG)
    assert names(watched) == []
    assert names(watched) == ["deep/a.png"]
    assert names(watched) == names(watched) == []
    path.write_bytes(PNG + b"more")
    assert names(watched) == []
    assert names(watched) == ["deep/a.png"]
    path.unlink()
    assert names(watched) == []


def test_files_come_by_age_and_without_those_that_are_done(tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    out.mkdir()
    for name, seconds in (("a.png", 10), ("b.png", 30), ("c.png", 20), ("d.png", 40)):
        (folder / name).write_bytes(PNG)
        age(folder / name, seconds)
    (out / "c.png").write_bytes(PNG)
    (out / "d.png").write_bytes(PNG)
    age(out / "d.png", 50)
    watched = Watched(folder, out)
    assert names(watched) == []
    assert names(watched) == ["d.png", "b.png", "a.png"]


def test_results_inside_of_the_folder_are_no_input(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "a.png").write_bytes(PNG)
    watched = Watched(tmp_path, tmp_path / "out")
    assert names(watched) == names(watched) == []
    with pytest.raises(FactoryError, match="is the folder that is watched"):
        Watched(tmp_path, tmp_path)
    with pytest.raises(FactoryError, match="no such folder"):
        Watched(tmp_path / "nowhere", tmp_path / "out")


def test_a_folder_of_pictures_that_broke_off_is_done_again(tmp_path: Path) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    write_oculus(folder / "a.raw", pings(1, 20, 16))

    def breaks_off(item: Item) -> None:
        (out / item.relative).mkdir(parents=True)
        raise KeyboardInterrupt

    watch(Watched(folder, out), breaks_off, 1.0, lambda seconds: None)
    assert (out / "a.raw").is_dir()
    again = Watched(folder, out)
    assert names(again) == []
    assert names(again) == ["a.raw"]


def test_the_command_denoises_what_comes_until_it_is_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "asked_denoiser", lambda *given, **named: Halving())
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    whole = write_aris(tmp_path / "whole.aris", pings(2, 20, 48)).read_bytes()
    steps: list[Callable[[], object]] = [
        lambda: (folder / "a.aris").write_bytes(whole[:3000]),
        lambda: (folder / "a.aris").write_bytes(whole),
        lambda: (folder / "bad.png").write_bytes(PNG[:25]),
        lambda: (folder / "b.png").write_bytes(PNG),
        lambda: None,
        lambda: None,
    ]

    def sleep(seconds: float) -> None:
        assert seconds == 0.5
        if not steps:
            raise KeyboardInterrupt
        steps.pop(0)()

    monkeypatch.setattr("simnfnd.models.denoise.watch.watch.__defaults__", (sleep,))
    words = ["--watch", str(folder), "--out", str(out), "--every", "0.5", "--geometry", "none"]
    assert main(words) == 0
    said = capsys.readouterr()
    assert [line.split(":")[0] for line in said.out.splitlines()] == [
        f"watching {folder}; Ctrl-C ends",
        "a.aris",
        "b.png",
        "weights",
        "denoised",
    ]
    assert said.err.startswith("skipped: ")
    assert "bad.png: not a readable" in said.err
    assert said.err.count("\n") == 1
    assert sorted(path.name for path in out.iterdir()) == ["a.aris", "b.png"]
    assert (cv2.imread(str(out / "b.png"), cv2.IMREAD_UNCHANGED) == 40).all()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ([], "give files or folders to denoise, or --watch"),
        (["a.png", "--watch", "."], "and not both"),
        (["--watch", ".", "--every", "0"], "--every 0: give seconds"),
    ],
)
def test_words_that_do_not_go_together(tmp_path: Path, words: list[str], why: str) -> None:
    with pytest.raises(FactoryError, match=why):
        main([*words, "--out", str(tmp_path / "out")])


def test_pictures_that_come_are_fused_with_those_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(command, "asked_denoiser", lambda *given, **named: Halving())
    folder, out = tmp_path / "in", tmp_path / "out"
    folder.mkdir()
    come = iter(range(5))

    def sleep(seconds: float) -> None:
        number = next(come, None)
        if number is None:
            raise KeyboardInterrupt
        if number < 3:
            write(folder / f"f{number}.png", noisy(scene(0), number))

    monkeypatch.setattr("simnfnd.models.denoise.watch.watch.__defaults__", (sleep,))
    words = ["--watch", str(folder), "--out", str(out), "--geometry", "none", "--causal"]
    assert command.main(words) == 0
    assert sorted(path.name for path in out.iterdir()) == ["f0.png", "f1.png", "f2.png"]
    assert "in time: " in capsys.readouterr().out
