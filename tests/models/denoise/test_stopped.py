"""A run that is stopped leaves no half file and goes on; no file that is written is an input."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.command import main as simnfnd_main
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise import command
from simnfnd.models.denoise.inputs import NAME, items_below
from simnfnd.models.denoise.pictures import Gray
from tests.models.adapt.scenes import noisy, scene, write


class Stopping:
    """Halves, and is stopped by a signal at a picture."""

    name, digest = "stopping", "0"

    def __init__(self, at: int | None, number: int) -> None:
        self.at, self.number, self.count = at, number, 0

    def __call__(self, gray: Gray, geometry: FanGeometry | None = None) -> Gray:
        self.count += 1
        if self.count == self.at:
            os.kill(os.getpid(), self.number)
        return gray / 2


def use(monkeypatch: pytest.MonkeyPatch, at: int | None, number: int = signal.SIGINT) -> Stopping:
    made = Stopping(at, number)
    monkeypatch.setattr(command, "Denoiser", lambda *given, **named: made)
    return made


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
    for one in range(12):
        write(tmp_path / "in" / f"f{one:02d}.png", noisy(scene(0), one))
    out = tmp_path / "out"
    words = [str(tmp_path / "in"), "--out", str(out), "--geometry", "none", "--frames", window]
    use(monkeypatch, 9, number)
    assert simnfnd_main(["denoise", *words]) == code
    done = {path.name: path.stat().st_mtime_ns for path in out.glob("*.png")}
    assert 0 < len(done) < 12
    assert f"denoised: {len(done)} file(s) in {out} before it was stopped" in (
        capsys.readouterr().err
    )
    use(monkeypatch, None)
    assert command.main(words) == 0
    assert f"already denoised: {len(done)} file(s)" in capsys.readouterr().out
    assert len(list(out.glob("*.png"))) == 12
    assert all((out / name).stat().st_mtime_ns == time for name, time in done.items())
    assert not (out / NAME).exists()
    # A run that came to its end is done again.
    again = use(monkeypatch, None)
    assert command.main(words) == 0
    assert again.count >= 12


def test_another_command_begins_anew(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for one in range(4):
        write(tmp_path / "in" / f"f{one}.png", noisy(scene(0), one))
    words = [str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--geometry", "none"]
    use(monkeypatch, 3)
    with pytest.raises(KeyboardInterrupt):
        command.main([*words, "--frames", "1"])
    anew = use(monkeypatch, None)
    assert command.main([*words, "--frames", "1", "--compare"]) == 0
    assert anew.count == 4


def test_a_video_that_is_stopped_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = tmp_path / "in" / "a.avi"
    source.parent.mkdir()
    code = cv2.VideoWriter.fourcc(*"FFV1")
    writer = cv2.VideoWriter(str(source), code, 5.0, (64, 64))
    for one in range(8):
        grey = np.rint(noisy(scene(0), one) * 255).astype(np.uint8)
        writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    writer.release()
    out = tmp_path / "out"
    words = [str(source), "--out", str(out), "--geometry", "none", "--frames", "1"]
    use(monkeypatch, 5)
    with pytest.raises(KeyboardInterrupt):
        command.main(words)
    assert [path.name for path in out.iterdir()] == [NAME]
    # What a killed run left is no input, and goes with the next one.
    (out / ".a.99999999.tmp.avi").write_bytes(b"half")
    assert items_below(out, tmp_path / "elsewhere") == []
    use(monkeypatch, None)
    assert command.main(words) == 0
    assert [path.name for path in out.iterdir()] == ["a.avi"]


def test_no_input_is_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By no result, and by no sheet to compare by."""
    folder = tmp_path / "in/compare"
    pictures = [folder / "a.png", folder / "a.png.png"]
    for picture in pictures:
        write(picture, scene(0))
    before = pictures[0].read_bytes()
    use(monkeypatch, None)
    for out, compare in ((folder, []), (folder.parent, ["--compare"])):
        words = [*map(str, pictures), "--out", str(out), *compare]
        with pytest.raises(FactoryError, match="would overwrite the input"):
            command.main(words)
    assert [picture.read_bytes() for picture in pictures] == [before] * 2
    assert sorted(folder.iterdir()) == pictures
    assert list(folder.parent.iterdir()) == [folder]


def test_sheets_of_one_name_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for suffix in (".png", ".bmp", ".tif"):
        write(tmp_path / "in" / f"a{suffix}", scene(0))
    use(monkeypatch, None)
    out = tmp_path / "out"
    words = [str(tmp_path / "in"), "--out", str(out), "--compare", "--geometry", "none"]
    assert command.main(words) == 0
    names = sorted(path.name for path in (out / "compare").iterdir())
    assert names == ["a.bmp.png", "a.png.png", "a.tif.png"]
