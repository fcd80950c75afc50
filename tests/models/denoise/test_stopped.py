"""A run that is stopped goes on to the same bytes, alone in its folder, and leaves no half file."""

from __future__ import annotations

import errno
import os
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.command import main as simnfnd_main
from simnfnd.factory.common.array_types import Float32s
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.files import explain_os_errors, space, write_atomically
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.denoise import command, options, writers
from simnfnd.models.denoise.journal import JOURNAL_NAME, opened_journal
from simnfnd.models.denoise.reports import TABLE
from simnfnd.models.recordings.inputs import InputFile, items_below
from tests.models.adapt.scenes import noisy, scene, write


class Stopping:
    """Halves, and is stopped by a signal at an image."""

    name = "stopping"
    digest = "0"

    def __init__(self, at: int | None, number: int) -> None:
        self.at = at
        self.number = number
        self.count = 0

    def __call__(self, grey: Float32s, geometry: FanGeometry | None = None) -> Float32s:
        self.count += 1
        if self.count == self.at:
            os.kill(os.getpid(), self.number)
        return self.denoised(grey)

    def denoised(self, grey: Float32s) -> Float32s:
        return grey / 2


class Smoothing(Stopping):
    """Smooths, so that the recording finds a strength for it."""

    def denoised(self, grey: Float32s) -> Float32s:
        return np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.5), np.float32)


def use(
    monkeypatch: pytest.MonkeyPatch,
    at: int | None,
    number: int = signal.SIGINT,
    kind: type[Stopping] = Stopping,
) -> Stopping:
    denoiser = kind(at, number)
    monkeypatch.setattr(command, "Denoiser", lambda *arguments, **named: denoiser)
    return denoiser


@pytest.mark.parametrize(
    ("number", "window", "code"), [(signal.SIGTERM, "1", 143), (signal.SIGINT, "3", 130)]
)
def test_what_is_done_is_skipped_by_the_next_run(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    number: int,
    window: str,
    code: int,
) -> None:
    for index in range(24):
        write(tmp_path / "in" / f"f{index:02d}.png", noisy(scene(0), index))
    out = tmp_path / "out"
    words = [str(tmp_path / "in"), "--out", str(out), "--geometry", "none", "--frames", window]
    use(monkeypatch, 20, number)
    assert simnfnd_main(["denoise", *words]) == code
    done = {path.name: path.stat().st_mtime_ns for path in out.glob("*.png")}
    assert 0 < len(done) < 24
    assert f"denoised: {len(done)} file(s) in {out} before it was stopped" in (
        capsys.readouterr().err
    )
    use(monkeypatch, None)
    assert options.main(words) == 0
    assert f"already denoised: {len(done)} file(s)" in capsys.readouterr().out
    assert len(list(out.glob("*.png"))) == 24
    assert all((out / name).stat().st_mtime_ns == time for name, time in done.items())
    # A run that came to its end is done again where that is asked for.
    for more, count in (([], 0), (["--again"], 24)):
        again = use(monkeypatch, None)
        assert options.main([*words, *more]) == 0
        assert again.count >= count
        assert (again.count == 0) == (count == 0)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stopped_run_ends_with_the_bytes_of_an_undisturbed_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: int
) -> None:
    """Though the strength changes as the recording goes on."""
    for index in range(30):
        write(tmp_path / "in" / f"f{index:02d}.png", noisy(scene(0), index))
    words = [str(tmp_path / "in"), "--geometry", "none", "--frames", "3", "--out"]

    use(monkeypatch, None, kind=Smoothing)
    assert simnfnd_main(["denoise", *words, str(tmp_path / "whole")]) == 0
    whole = images_in(tmp_path / "whole")
    assert len(whole) == 30

    use(monkeypatch, 25, number, Smoothing)
    assert simnfnd_main(["denoise", *words, str(tmp_path / "out")]) == 128 + number
    done = images_in(tmp_path / "out")
    assert 0 < len(done) < 30
    resumed = use(monkeypatch, None, kind=Smoothing)
    assert simnfnd_main(["denoise", *words, str(tmp_path / "out")]) == 0
    assert images_in(tmp_path / "out") == whole
    assert resumed.count < 60, "finished frames cost no network but where the strength is measured"


def images_in(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.glob("*.png")}


def test_after_a_full_disk_the_same_command_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for index in range(9):
        write(tmp_path / "in" / f"f{index}.png", noisy(scene(0), index))
    out = tmp_path / "out"
    words = ["denoise", str(tmp_path / "in"), "--out", str(out), "--geometry", "none"]
    use(monkeypatch, None)

    def full(path: Path, content: bytes, **options: str) -> None:
        if path.name == "f5.png":
            with explain_os_errors(path, "--out"):
                raise OSError(errno.ENOSPC, "No space left on device")
        write_atomically(path, content, key="--out")

    with monkeypatch.context() as disk:
        disk.setattr(writers, "write_atomically", full)
        assert simnfnd_main(words) == 2
    assert "no room to write" in capsys.readouterr().err
    done = images_in(out)
    assert sorted(done) == [f"f{index}.png" for index in range(5)]
    assert simnfnd_main(words) == 0
    assert "already denoised: 5 file(s)" in capsys.readouterr().out
    assert len(images_in(out)) == 9
    assert done.items() <= images_in(out).items()


def test_a_second_run_into_the_same_folder_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path / "a.png", scene(0))
    out = tmp_path / "out"
    out.mkdir()
    words = [str(tmp_path / "a.png"), "--out", str(out), "--geometry", "none"]
    use(monkeypatch, None)
    with opened_journal(out, "others") as others:
        others.begin([[InputFile(tmp_path / "b.png", Path("b.png"))]], in_time=True)
        before = sorted(path.name for path in out.iterdir())
        with pytest.raises(FactoryError, match=rf"--out .*: process {os.getpid()}"):
            options.main(words)
        assert sorted(path.name for path in out.iterdir()) == before
    assert options.main(words) == 0
    assert sorted(path.name for path in out.iterdir()) == [JOURNAL_NAME, "a.png", TABLE]


def test_a_killed_run_keeps_what_its_journal_names(tmp_path: Path) -> None:
    """A line that was cut off names nothing; another command's journal neither."""
    items = [InputFile(tmp_path / name, Path(name)) for name in ("a.png", "b.png", "c.png")]
    for item in items:
        (tmp_path / item.relative).touch()
    runs = [[item] for item in items]
    with opened_journal(tmp_path, "words") as journal:
        journal.begin(runs, in_time=True)
        size = (tmp_path / JOURNAL_NAME).stat().st_size
        for item in items[:2]:
            journal.add(item, {"file": item.relative.name})
        assert (tmp_path / JOURNAL_NAME).stat().st_size == size, "a full disk takes the names"
    content = (tmp_path / JOURNAL_NAME).read_bytes()
    cut = content.replace(b'"b.png"', b'"b.p   ')
    for remaining, expected in ((content, items[:2]), (cut, items[:1]), (b"", []), (b"\xff{", [])):
        for command_words, names in (("words", expected), ("others", [])):
            (tmp_path / JOURNAL_NAME).write_bytes(remaining)
            with opened_journal(tmp_path, command_words) as journal:
                journal.begin(runs, in_time=True)
                assert [item for item in items if item in journal] == names


def test_another_command_begins_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for index in range(4):
        write(tmp_path / "in" / f"f{index}.png", noisy(scene(0), index))
    words = [str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--geometry", "none"]
    use(monkeypatch, 3)
    with pytest.raises(KeyboardInterrupt):
        options.main([*words, "--frames", "1"])
    anew = use(monkeypatch, None)
    assert options.main([*words, "--frames", "1", "--compare"]) == 0
    assert anew.count == 4


def test_a_video_that_is_stopped_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "in" / "a.avi"
    source.parent.mkdir()
    code = cv2.VideoWriter.fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(source), code, 5.0, (64, 64))
    for index in range(8):
        grey = np.rint(noisy(scene(0), index) * 255).astype(np.uint8)
        writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    writer.release()
    out = tmp_path / "out"
    words = [str(source), "--out", str(out), "--geometry", "none", "--frames", "1"]
    use(monkeypatch, 5)
    with pytest.raises(KeyboardInterrupt):
        options.main(words)
    assert [path.name for path in out.iterdir() if path.name[0] != "."] == []
    # What a killed run left is no input, and goes with the next one.
    left = out / f".a.avi.{space()}-99999999-0123456789abcdef.tmp"
    left.write_bytes(b"half")
    assert items_below(out, tmp_path / "elsewhere") == []
    use(monkeypatch, None)
    assert options.main(words) == 0
    assert sorted(path.name for path in out.iterdir()) == [JOURNAL_NAME, "a.avi", TABLE]


def test_no_input_is_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By no result, and by no sheet to compare by."""
    folder = tmp_path / "in/compare"
    images = [folder / "a.png", folder / "a.png.png"]
    for image in images:
        write(image, scene(0))
    before = images[0].read_bytes()
    use(monkeypatch, None)
    for out, compare in ((folder, []), (folder.parent, ["--compare"])):
        words = [*map(str, images), "--out", str(out), *compare]
        with pytest.raises(FactoryError, match="overwrite"):
            options.main(words)
    assert [image.read_bytes() for image in images] == [before] * 2
    assert sorted(folder.iterdir()) == images
    assert list(folder.parent.iterdir()) == [folder]


def test_sheets_of_one_name_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for suffix in (".png", ".bmp", ".tif"):
        write(tmp_path / "in" / f"a{suffix}", scene(0))
    use(monkeypatch, None)
    out = tmp_path / "out"
    words = [str(tmp_path / "in"), "--out", str(out), "--compare", "--geometry", "none"]
    assert options.main(words) == 0
    names = sorted(path.name for path in (out / "compare").iterdir())
    assert names == ["a.bmp.png", "a.png", "a.tif.png"]
