"""`simnfnd denoise --frames`: neighbours in time are averaged where the scene stands still."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise import command
from simnfnd.models.denoise.command import main
from simnfnd.models.denoise.files import Gray
from simnfnd.models.denoise.inputs import Item
from simnfnd.models.denoise.temporal import neighbours
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.averaging import Averager, windows
from tests.models.adapt.scenes import SIDE, noisy, scene, write
from tests.models.recordings.recording_files import write_aris

EVERYWHERE = np.ones((SIDE, SIDE), bool)


class AsItIs:
    """A denoiser that changes nothing."""

    digest, pictures, unchanged, looks = "0", 0, 0, 1

    def __call__(self, gray: Gray, geometry: FanGeometry | None = None) -> Gray:
        return gray


@pytest.fixture(autouse=True)
def as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "asked_denoiser", lambda *given, **named: AsItIs())


def error(picture: Gray, truth: Gray) -> float:
    return float((picture - truth)[4:-4, 4:-4].std())


@pytest.mark.parametrize("reach", [0, 1, 3])
@pytest.mark.parametrize("count", [0, 1, 2, 4, 9])
def test_windows_hold_each_with_its_neighbours(count: int, reach: int) -> None:
    found = list(windows(range(count), reach))
    assert [window[place] for place, window in found] == list(range(count))
    for number, (_, window) in enumerate(found):
        assert window == list(range(max(0, number - reach), min(count, number + reach + 1)))


def test_shifted_frames_are_laid_over_each_other() -> None:
    wide = scene(0, SIDE + 16, SIDE + 16)
    shifts = [(0.0, 0.0), (0.5, 0.25), (-1.25, 0.75), (1.5, -0.5), (0.0, 2.0)]
    seen = {}
    for number, (right, down) in enumerate(shifts):
        matrix = np.array([[1, 0, 8 - right], [0, 1, 8 - down]], np.float64)
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        moved = cv2.warpAffine(wide, matrix, (SIDE, SIDE), flags=flags)
        seen[number] = noisy(np.asarray(moved, np.float32), number)
    truth = wide[8:-8, 8:-8]
    average = Averager()(0, dict(seen), EVERYWHERE)
    assert average.frames > 4.8
    # Of five frames the noise is 1 / sqrt(5), and interpolation takes some more.
    assert error(average.picture, truth) < 0.5 * error(seen[0], truth)


def test_what_does_not_fit_is_left_out() -> None:
    one = noisy(scene(0), 0)
    window = {"own": one, "other scene": noisy(scene(1), 1), "other size": scene(2, 32, 40)}
    average = Averager()("own", window, EVERYWHERE)
    assert np.array_equal(average.picture, one)
    assert average.frames == 1


def test_what_moves_stays_where_it_is() -> None:
    truth, window = [], {}
    for number in range(5):
        picture = scene(0)
        picture[20:32, 8 * number + 8 : 8 * number + 20] = 1
        truth.append(picture)
        window[number] = noisy(picture, number, 0.04)
    average = Averager()(2, dict(window), EVERYWHERE)
    assert 3 < average.frames < 4.9
    trail = np.s_[22:30, 10:50]
    assert np.abs(average.picture - truth[2])[trail].mean() < 0.04
    blurred = np.mean(list(window.values()), axis=0)
    assert np.abs(blurred - truth[2])[trail].mean() > 0.1
    assert error(average.picture[40:], truth[2][40:]) < 0.7 * error(window[2][40:], truth[2][40:])


def test_pictures_of_a_sequence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, out = tmp_path / "in", tmp_path / "out"
    frames = [noisy(scene(0), number) for number in range(5)]
    for number, frame in enumerate(frames):
        write(folder / f"f{number + 8}.png", frame)
    write(folder / "else.png", frames[0])
    alpha = np.dstack([*3 * [np.rint(frames[0] * 255)], np.full((SIDE, SIDE), 7)])
    assert cv2.imwrite(str(folder / "g1.png"), alpha.astype(np.uint8))
    assert cv2.imwrite(str(folder / "g2.png"), alpha.astype(np.uint8))
    assert main([str(folder), "--out", str(out), "--frames", "5", "--geometry", "none"]) == 0
    said = capsys.readouterr().out
    # Windows of 3, 4, 5, 4 and 3 frames, and twice two.
    assert "averaged: 3.3 of up to 5 frames a picture" in said
    after = cv2.imread(str(out / "f10.png"), 0).astype(np.float32) / 255
    assert error(after, scene(0)) < 0.55 * error(frames[2], scene(0))
    assert (out / "else.png").read_bytes() == (folder / "else.png").read_bytes()
    shown = cv2.imread(str(out / "g1.png"), cv2.IMREAD_UNCHANGED)
    assert (shown[..., 3] == 7).all()
    assert np.abs(shown[..., 0] / 255 - frames[0]).max() < 0.01


def test_pings_of_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    truth = scene(0, 80, 48)
    pings = np.stack([np.rint(noisy(truth, number) * 255).astype(np.uint8) for number in range(4)])
    write_aris(tmp_path / "a.aris", pings)
    assert main([str(tmp_path / "a.aris"), "--out", str(tmp_path / "out"), "--frames", "7"]) == 0
    assert "averaged: 4.0 of up to 7" in capsys.readouterr().out
    with open_recording(tmp_path / "out" / "a.aris") as after:
        assert len(after) == 4
        for frame, ping in zip(after, pings, strict=True):
            denoised = frame.samples.astype(np.float32) / 255
            assert error(denoised, truth) < 0.65 * error(ping / np.float32(255), truth)


def test_sequences_are_told_by_names(tmp_path: Path) -> None:
    names = ["a2.png", "a10.png", "a1.png", "b3.png", "c.png", "a3.jpg", "deep/a4.png"]
    items = [Item(tmp_path / name, Path(name)) for name in names]
    found = {
        path.relative_to(tmp_path).as_posix(): [one.name for one in window]
        for path, window in neighbours(items, 1).items()
    }
    assert found == {
        "a1.png": ["a1.png", "a2.png"],
        "a2.png": ["a1.png", "a2.png", "a10.png"],
        "a10.png": ["a2.png", "a10.png"],
        "b3.png": ["b3.png"],
        "a3.jpg": ["a3.jpg"],
        "deep/a4.png": ["a4.png"],
    }


@pytest.mark.parametrize("frames", ["0", "2", "-1", "99"])
def test_numbers_of_frames_that_cannot_be(tmp_path: Path, frames: str) -> None:
    write(tmp_path / "a.png", scene(0))
    with pytest.raises(FactoryError, match="odd number up to 31"):
        main([str(tmp_path / "a.png"), "--out", str(tmp_path / "out"), "--frames", frames])
