"""`simnfnd denoise` of pictures and videos whose colours stand for levels of echo."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.models.denoise import command
from simnfnd.models.denoise.pictures import Gray
from simnfnd.models.recordings import open_recording
from tests.models.adapt.scenes import noisy, scene
from tests.models.denoise.halving import main

Bytes = npt.NDArray[Any]


class Darker:
    """A denoiser whose result is easy to foretell; it knows grey pictures alone."""

    name, digest = "darker", "0"

    def __call__(self, gray: Gray, geometry: object = None) -> Gray:
        assert gray.ndim == 2
        return gray / 2


@pytest.fixture(autouse=True)
def darker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "Denoiser", lambda *given, **named: Darker())


def levels_of(number: int) -> Bytes:
    return np.asarray(np.rint(np.clip(noisy(scene(0), number), 0, 1) * 255), np.uint8)


def jet(levels: npt.NDArray[np.floating] | Bytes) -> Bytes:
    rounded = np.rint(levels).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(rounded, cv2.COLORMAP_JET), np.uint8)


def away(one: npt.NDArray[Any], other: Bytes) -> float:
    return float(np.abs(one.astype(int) - other).mean())


def test_a_picture_is_painted_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    levels = levels_of(0)
    (tmp_path / "in").mkdir()
    for suffix in ("png", "tif", "bmp"):
        assert cv2.imwrite(str(tmp_path / "in" / f"a.{suffix}"), jet(levels))
    words = [str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--weights", "x", "--compare"]
    assert main(words) == 0
    for suffix in ("png", "tif", "bmp"):
        result = cv2.imread(str(tmp_path / "out" / f"a.{suffix}"), cv2.IMREAD_UNCHANGED)
        assert away(result, jet(levels / 2)) < 2
    assert "colour maps: jet in 3" in capsys.readouterr().out


def test_a_video_is_painted_again(tmp_path: Path) -> None:
    path = tmp_path / "a.avi"
    code = cv2.VideoWriter.fourcc(*"FFV1")
    frames = [levels_of(number)[:60, :62] for number in range(3)]
    writer = cv2.VideoWriter(str(path), code, 5.0, frames[0].shape[::-1])
    for frame in frames:
        writer.write(jet(frame))
    writer.release()
    assert main([str(path), "--out", str(tmp_path / "out"), "--weights", "x"]) == 0
    with open_recording(tmp_path / "out" / "a.avi") as denoised:
        for before, after in zip(frames, denoised, strict=True):
            assert away(after.samples, jet(before / 2)) < 8, "a codec of video mixes colours"
