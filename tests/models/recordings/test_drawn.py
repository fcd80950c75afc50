"""Rings and bearings that are drawn over a grey fan, in white or grey."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise.pictures import denoise_image
from simnfnd.models.recordings.fan.drawn import filled, without_lines
from tests.models.recordings.fan_pictures import fan, preset

Picture = npt.NDArray[Any]
RINGS, BEARINGS = (0.5, 0.75), (-0.6, 0.0, 0.4)


def made() -> tuple[Picture, FanGeometry]:
    return fan(preset("didson_hf", 300, 400), 0.3, holes=False)


def drawn_over(
    grey: Picture, place: FanGeometry, level: int, *, thick: int = 1, smooth: bool = False,
    rings: tuple[float, ...] = RINGS, bearings: tuple[float, ...] = BEARINGS,
) -> Picture:  # fmt: skip
    picture = grey.copy()
    kind = cv2.LINE_AA if smooth else cv2.LINE_8
    # In sixteenths of a pixel.
    apex = round(16 * place.apex_x_px), round(16 * place.apex_y_px)
    half_rad = place.sector_rad / 2
    for part in rings:
        size = round(16 * part * place.far_px), round(16 * part * place.far_px)
        half_deg = float(np.rad2deg(half_rad))
        cv2.ellipse(
            picture, apex, size, 0, -90 - half_deg, -90 + half_deg, (level,), thick, kind, 4
        )
    for part in bearings:
        across = 16 * place.far_px * np.sin(part * half_rad)
        ahead = 16 * place.far_px * np.cos(part * half_rad)
        end = round(apex[0] + across), round(apex[1] - ahead)
        cv2.line(picture, apex, end, (level,), thick, kind, 4)
    return picture


def in_unit(picture: Picture) -> Picture:
    return picture.astype(np.float32) / np.float32(255)


@pytest.mark.parametrize(("level", "thick", "smooth"), [
    (255, 1, False), (255, 2, False), (255, 1, True), (255, 2, True),
    (200, 1, False), (200, 2, True),
])  # fmt: skip
def test_lines_are_found_and_filled(level: int, thick: int, smooth: bool) -> None:
    grey, place = made()
    shown = drawn_over(grey, place, level, thick=thick, smooth=smooth)
    found = without_lines(in_unit(shown), place)
    assert found is not None
    ground, lines = found
    there = (shown.astype(int) - grey > 0.4 * (level - 80)) & place.sector_mask(*grey.shape)
    assert lines[there].mean() > 0.85
    assert (lines & (shown == grey)).sum() < 0.35 * there.sum()
    np.testing.assert_array_equal(ground[~lines], in_unit(shown)[~lines])
    before, after = (np.abs(one - in_unit(grey))[there].mean() for one in (in_unit(shown), ground))
    assert after < 0.4 * before


def test_lines_of_a_dark_picture_are_found() -> None:
    """Twelve bits in sixteen."""
    grey, place = made()
    shown = in_unit(drawn_over(grey, place, 255))
    bright, dark = without_lines(shown, place), without_lines(shown / 16, place)
    assert bright is not None
    assert dark is not None
    assert (bright[1] == dark[1]).mean() > 0.999


def test_pictures_without_lines_stay_as_they_are() -> None:
    grey, place = made()
    assert without_lines(in_unit(grey), place) is None
    assert without_lines(in_unit(grey), None) is None
    assert without_lines(in_unit(grey), FanGeometry.polar().with_size(*grey.shape)) is None
    assert without_lines(np.zeros(grey.shape, np.float32), place) is None


@pytest.mark.parametrize("bright", ["bearing", "spoke beside rings", "wall", "arc of echoes"])
def test_echoes_are_no_lines(bright: str) -> None:
    grey, place = made()
    maps = place.maps(0, 0, *grey.shape)
    shown = grey.copy()
    if bright == "bearing":  # as a spoke of one beam looks
        shown = drawn_over(grey, place, 255, rings=())
    elif bright == "spoke beside rings":
        beam = np.abs(maps["azimuth_rad"] - 0.3 * place.azimuth_max_rad) < 0.01
        rings = drawn_over(grey, place, 255, bearings=())
        with_spoke = rings.copy()
        with_spoke[beam & (maps["sector"] > 0)] = 255
        found = without_lines(in_unit(with_spoke), place)
        assert found is not None
        assert found[1][beam & (rings < 200)].mean() < 0.05
        return
    elif bright == "wall":  # bright all along, and thick
        wall = np.abs(maps["range_fraction"] - 0.6) * place.far_px < 8
        shown[wall & (maps["sector"] > 0)] = 255
    else:  # narrow, but uneven as echoes are
        arc = np.abs(maps["range_fraction"] - 0.6) * place.far_px < 1.5
        where = arc & (maps["sector"] > 0)
        shown[where] = np.random.default_rng(2).rayleigh(120, where.sum()).clip(0, 255)
    assert without_lines(in_unit(shown), place) is None


def test_filling_takes_nothing_of_the_marks() -> None:
    grey = np.full((20, 30), 0.25, np.float32)
    marks = np.zeros(grey.shape, bool)
    marks[8:10] = True
    grey[marks] = 1
    np.testing.assert_allclose(filled(grey, marks), 0.25, atol=1e-6)
    everything = np.ones(grey.shape, bool)
    np.testing.assert_array_equal(filled(grey, everything), grey)


def test_lines_stay_when_the_fan_is_denoised() -> None:
    grey, place = made()
    shown = drawn_over(grey, place, 255, thick=2)
    seen = []

    def halving(picture: Picture, geometry: FanGeometry | None = None, looks: Any = ()) -> Picture:
        seen.append([picture, *looks])
        return picture / 2

    result = denoise_image(shown, halving, place)
    found = without_lines(in_unit(shown), place)
    assert found is not None
    lines = found[1]
    np.testing.assert_array_equal(result[lines], shown[lines])
    np.testing.assert_allclose(result[~lines], shown[~lines] / 2, atol=0.5)
    assert seen[0][0][lines].max() < 0.9
    denoise_image(shown, halving, place, [shown, shown, shown])
    assert all(look[lines].max() < 0.9 for look in seen[1])
    # Shards hold what a factory made: nobody has drawn there.
    alone = denoise_image(shown, halving, place, echoes_alone=True)
    np.testing.assert_allclose(alone, shown / 2, atol=0.5)
