"""Cells of a sonar that are wider than pixels are measured, and denoised as the cells they are."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Float32s
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.denoise.denoiser import Denoiser
from simnfnd.models.denoise.polar import Maps, polar_grid, sampled
from simnfnd.models.denoise.wide_cells import by_cells, cell_width
from tests.models.denoise.test_golden import pairs, psnr

SIDE = 256  # of the images that are enlarged


class Enlarged(NamedTuple):
    """An image of points whose cells are some pixels wide, (H, W), without noise, and its maps."""

    noisy: Float32s
    clean: Float32s
    geometry: FanGeometry
    maps: Maps


def enlarged(width: float, number: int = 0) -> Enlarged:
    noisy, clean, geometry = pairs("points")[number]
    side = round(SIDE * width)
    larger = geometry.scaled(side, side, width)
    wide_noisy, wide_clean = (
        np.asarray(cv2.resize(image, (side, side)), np.float32) for image in (noisy, clean)
    )
    return Enlarged(wide_noisy, wide_clean, larger, larger.maps(0, 0, side, side))


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("width", [1.0, 1.5, 2.0, 3.0, 4.0])
def test_the_width_of_cells_is_measured(width: float, number: int) -> None:
    image = enlarged(width, number)
    grid = polar_grid(image.maps)
    assert grid is not None
    actual = cell_width(sampled(image.noisy, grid.cells_in_fan))
    assert actual == pytest.approx(width, abs=0.15)


@pytest.mark.parametrize("grey", [0.0, 0.5])
def test_an_image_without_grain_has_no_wide_cells(grey: float) -> None:
    assert cell_width(np.full((SIDE, SIDE), grey, np.float32)) == 1.0


@pytest.mark.parametrize(("width", "side"), [(1.0, SIDE), (2.0, SIDE), (1.25, 256)])
def test_a_network_sees_a_grid_of_cells(width: float, side: int) -> None:
    image = enlarged(width)
    sides = []

    def denoise(grey: Float32s, maps: Maps) -> Float32s:
        assert all(plane.shape == grey.shape for plane in maps.values())
        # All of a row have one range where cells are wide: a network takes that for polar.
        assert (polar_grid(maps) is None) == (width > 1)
        sides.append(grey.shape[0])
        return grey

    actual = by_cells(image.noisy, image.maps, denoise)
    assert sides == [pytest.approx(side, rel=0.15)]
    # What a network leaves as it is, stays as it is.
    np.testing.assert_allclose(actual, image.noisy, atol=1e-4)


def test_images_of_unknown_geometry_are_denoised_as_they_are() -> None:
    noisy = enlarged(2.0).noisy
    actual = by_cells(noisy, {}, lambda grey, _: 0.5 * grey)
    np.testing.assert_array_equal(actual, 0.5 * noisy)


def test_nothing_changes_outside_the_sector() -> None:
    image = enlarged(2.0)
    noisy = image.noisy.copy()
    outside = image.maps["sector"] <= 0
    noisy[outside] = 0.25
    actual = by_cells(noisy, image.maps, lambda grey, _: np.zeros_like(grey))
    np.testing.assert_array_equal(actual[outside], noisy[outside])
    assert not actual[~outside].any()


@pytest.mark.parametrize("number", [0, 1])
def test_weights_that_ship_denoise_wide_cells_as_narrow_ones(number: int) -> None:
    """Of the same image at twice the size, they remove nearly as many decibels of noise."""
    denoise = Denoiser("simnfnd-paper", "cpu")

    def gain_db(image: Enlarged) -> float:
        denoised = denoise(image.noisy, image.geometry)
        return psnr(denoised, image.clean) - psnr(image.noisy, image.clean)

    wide = enlarged(2.0, number)
    with_cells = gain_db(wide)
    assert with_cells > gain_db(enlarged(1.0, number)) - 1
    denoise.runtime.average_cells = False
    assert with_cells > gain_db(wide) + 1
