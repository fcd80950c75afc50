"""Large images are denoised in tiles without a seam, those of wide grain at smaller sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from simnfnd.factory.common.array_types import Float32s
from simnfnd.models.denoise.denoiser import Denoiser, tiled
from tests.small_dataset import fan_images


def test_tiles_leave_no_seam() -> None:
    rng = np.random.default_rng(0)
    image = rng.random((90, 130)).astype(np.float32)
    scale = {"scale": np.linspace(0, 1, 90 * 130, dtype=np.float32).reshape(90, 130)}

    def local(part: Float32s, maps: Any) -> Float32s:
        # What a network with a small field of view does: pixels and their neighbours.
        return np.asarray(ndimage.uniform_filter(part, 5, mode="nearest") * maps["scale"])

    whole = local(image, scale)
    parts = tiled(local, image, scale, 48, 20)
    np.testing.assert_allclose(parts[3:-3, 3:-3], whole[3:-3, 3:-3], atol=0.02)
    middle = np.abs(parts - whole)[3:-3, 3:-3]
    assert np.median(middle) < 1e-6


def test_large_images_are_denoised_in_tiles(weights: Path) -> None:
    noisy, _, _ = fan_images(96, np.random.default_rng(2))
    denoise = Denoiser(weights, "cpu")
    whole = denoise(noisy)
    denoise.tile = 64
    denoise.overlap = 24
    parts = denoise(noisy)
    # NAFNet's attention is a mean over the tile, so a little differs.
    assert np.abs(whole - parts).max() < 0.05
    assert parts.dtype == np.float32


def grain(side: int, seed: int = 0) -> Float32s:
    """Ground with things on it, and grain that is one pixel wide."""
    rng = np.random.default_rng(seed)
    truth = ground(side)
    noise = rng.rayleigh(0.8, (side, side)) * truth
    return np.asarray(noise.clip(0, 1), np.float32)


def ground(side: int) -> Float32s:
    row, column = np.mgrid[:side, :side] / side
    level = 0.35 + 0.15 * np.sin(5 * row + 3 * column)
    level[(row > 0.4) & (row < 0.6) & (column > 0.3) & (column < 0.5)] = 0.7
    return np.asarray(level, np.float32)


def larger(grey: Float32s, times: float) -> Float32s:
    actual = cv2.resize(grey, None, fx=times, fy=times, interpolation=cv2.INTER_LINEAR)
    return np.asarray(actual, np.float32)


def test_weights_that_ship_denoise_enlarged_images() -> None:
    """Twice as wide grain leaves hardly more noise than grain of a pixel."""
    once = Denoiser("simnfnd", "cpu")
    assert once.runtime.wide_grain == 0.56
    side = 200
    wide = larger(grain(side), 2)
    truth = larger(ground(side), 2)

    def error(denoise: Denoiser) -> float:
        actual = denoise(wide)
        level = actual.mean() / truth.mean()
        return float((actual / level - truth)[20:-20, 20:-20].std())

    with_scales = error(once)
    once.runtime.wide_grain = 1.0
    assert with_scales < 0.7 * error(once)
