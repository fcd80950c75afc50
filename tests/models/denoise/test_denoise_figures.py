"""`simnfnd denoise` on figures: their pictures change, and nothing else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise import command
from simnfnd.models.denoise.command import main
from simnfnd.models.denoise.files import Gray, denoise_image
from tests.models.recordings.figure_pictures import Bytes, Drawn, figure, sector, shown


class Dimming:
    """Lowers what it sees, and keeps it."""

    digest, pictures, unchanged, looks = "0", 0, 0, 1

    def __init__(self) -> None:
        self.seen: list[tuple[Gray, FanGeometry | None]] = []

    def __call__(self, gray: Gray, geometry: FanGeometry | None = None) -> Gray:
        self.seen.append((gray, geometry))
        inside = np.ones(gray.shape, bool)
        if geometry is not None:
            inside = geometry.sector_mask(*gray.shape)
        return np.where(inside, gray * np.float32(0.9), gray)


def speckle(seed: int = 3) -> Bytes:
    """Without black and white, so that all of it changes."""
    values = np.random.default_rng(seed).rayleigh(60, (300, 90))
    return np.clip(values, 30, 230).astype(np.uint8)


def changed(drawn: Drawn, result: npt.NDArray[Any]) -> tuple[float, int]:
    """Share of the pixels that changed within axes, and how many of the others did."""
    inside = np.zeros(result.shape[:2], bool)
    for rows, columns in drawn.boxes:
        inside[rows, columns] = True
    given = drawn.picture if result.ndim == 3 else drawn.grey
    other = (given != result) if result.ndim == 2 else (given != result).any(axis=2)
    return float(other[inside].mean()), int((other & ~inside).sum())


@pytest.mark.parametrize("look", ["default", "dark_background", "ggplot"])
def test_a_rectangle_alone_changes(look: str) -> None:
    denoise = Dimming()
    drawn = figure([shown(speckle())], look=look, bar=look != "ggplot")
    share, outside = changed(drawn, denoise_image(drawn.grey, denoise))
    assert share > 0.95
    assert outside == 0
    ((seen, geometry),) = denoise.seen
    assert geometry is None
    assert seen.shape[0] < 0.9 * len(drawn.grey), "the picture alone is seen"
    assert seen.min() > 0.05, "and none of the axes"


def test_lines_and_empty_pages_stay() -> None:
    drawn = figure([lambda axes: axes.plot(np.sin(np.arange(90)))])
    for picture in (drawn.grey, drawn.picture, np.full((200, 200), 255, np.uint8)):
        np.testing.assert_array_equal(denoise_image(picture, Dimming()), picture)


def test_each_of_several_changes(tmp_path: Path) -> None:
    denoise = Dimming()
    drawn = figure([shown(speckle(seed)) for seed in range(4)], columns=2)
    share, outside = changed(drawn, denoise_image(drawn.grey, denoise))
    assert (len(denoise.seen), outside) == (4, 0)
    assert share > 0.9


def test_each_fan_of_several_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    denoise = Dimming()
    monkeypatch.setattr(command, "asked_denoiser", lambda *given, **named: denoise)
    drawn = figure([sector(speckle(seed), 0.5, 0.2) for seed in range(2)], columns=2)
    assert cv2.imwrite(str(tmp_path / "a.png"), drawn.grey)
    assert main([str(tmp_path / "a.png"), "--out", str(tmp_path / "out")]) == 0
    assert "fan found in 1 of 1" in capsys.readouterr().out
    assert len(denoise.seen) == 2
    for _, geometry in denoise.seen:
        assert geometry is not None
        assert geometry.sector_rad == pytest.approx(1, rel=0.06)
    result = cv2.imread(str(tmp_path / "out" / "a.png"), cv2.IMREAD_GRAYSCALE)
    assert result is not None
    share, outside = changed(drawn, result)
    assert outside <= 2, "a sector's corner lies on the axes"
    assert share > 0.5


@pytest.mark.parametrize("colours", ["viridis", "jet"])
def test_colours_and_text_around_them_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, colours: str
) -> None:
    denoise = Dimming()
    monkeypatch.setattr(command, "asked_denoiser", lambda *given, **named: denoise)
    drawn = figure([shown(speckle(), colours)], bar=True)
    assert cv2.imwrite(str(tmp_path / "a.png"), drawn.picture[..., ::-1])
    assert main([str(tmp_path / "a.png"), "--out", str(tmp_path / "out")]) == 0
    result = cv2.imread(str(tmp_path / "out" / "a.png"))
    assert result is not None
    share, outside = changed(drawn, result[..., ::-1])
    assert share > 0.9
    assert outside == 0
