"""Pictures whose grain is wide are denoised at smaller sizes first."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from simnfnd.models.denoise.denoiser import Denoiser, Maps, by_scales, correlation
from simnfnd.models.denoise.pictures import Gray as Grey


def grain(side: int, seed: int = 0) -> Grey:
    """Ground with things on it, and grain that is one pixel wide."""
    rng = np.random.default_rng(seed)
    truth = ground(side)
    noise = rng.rayleigh(0.8, (side, side)) * truth
    return np.asarray(noise.clip(0, 1), np.float32)


def ground(side: int) -> Grey:
    row, column = np.mgrid[:side, :side] / side
    level = 0.35 + 0.15 * np.sin(5 * row + 3 * column)
    level[(row > 0.4) & (row < 0.6) & (column > 0.3) & (column < 0.5)] = 0.7
    return np.asarray(level, np.float32)


def larger(grey: Grey, times: float) -> Grey:
    found = cv2.resize(grey, None, fx=times, fy=times, interpolation=cv2.INTER_LINEAR)
    return np.asarray(found, np.float32)


def test_grain_of_a_pixel_is_not_wide_and_enlarged_grain_is() -> None:
    one = grain(256)
    assert correlation(one) < 0.1
    assert correlation(larger(one, 2)) > 0.6
    # Along one side alone it is as wide as the beams are far from each other.
    assert correlation(np.repeat(one, 4, axis=1)) < 0.1
    for picture in (np.zeros((256, 256), np.float32), np.full((256, 256), 0.5, np.float32)):
        assert correlation(picture) == pytest.approx(0, abs=1e-3)
    few = np.zeros((256, 256), np.float32)
    few[:20, :20] = one[:20, :20]
    assert correlation(few) == 0


def test_how_often_a_picture_is_halved() -> None:
    seen: list[tuple[int, ...]] = []

    def denoise(grey: Grey, maps: Maps) -> Grey:
        seen.append(grey.shape)
        assert all(plane.shape[:2] == grey.shape for plane in maps.values())
        assert set(np.unique(maps["sector"])) <= {0.0, 1.0}
        return grey

    sector = np.ones((801, 799), np.float32)
    sector[:, :100] = 0
    wide = larger(grain(200), 4)[:801, :799]
    wide = np.pad(wide, ((0, 801 - wide.shape[0]), (0, 0)), mode="edge")[:, :799]
    maps = {"sector": sector, "looks": np.dstack([wide] * 3)}
    result = by_scales(wide, maps, denoise, 0.56)
    assert seen == [(201, 200), (401, 400), (801, 799)]
    np.testing.assert_allclose(result, wide, atol=1e-6)
    for picture, widest in ((wide, 1.0), (grain(400), 0.56), (larger(grain(60), 3), 0.56)):
        seen.clear()
        by_scales(picture, {"sector": np.ones_like(picture)}, denoise, widest)
        assert seen == [picture.shape]


def test_outside_the_sector_nothing_changes() -> None:
    wide = larger(grain(200), 2)
    sector = np.zeros_like(wide)
    sector[100:300, 100:300] = 1

    def darker(grey: Grey, maps: Maps) -> Grey:
        return np.where(maps["sector"] > 0, grey / 2, grey)

    result = by_scales(wide, {"sector": sector}, darker, 0.56)
    np.testing.assert_array_equal(result[sector == 0], wide[sector == 0])
    assert result[150:250, 150:250].mean() < 0.3 * wide[150:250, 150:250].mean()


def test_weights_that_ship_denoise_enlarged_pictures() -> None:
    """Twice as wide grain leaves hardly more noise than grain of a pixel."""
    once = Denoiser("simnfnd", "cpu")
    assert once.runtime.wide_grain == 0.56
    side = 200
    wide, truth = larger(grain(side), 2), larger(ground(side), 2)

    def error(denoise: Denoiser) -> float:
        found = denoise(wide)
        level = found.mean() / truth.mean()
        return float((found / level - truth)[20:-20, 20:-20].std())

    with_scales = error(once)
    once.runtime.wide_grain = 1.0
    assert with_scales < 0.7 * error(once)
