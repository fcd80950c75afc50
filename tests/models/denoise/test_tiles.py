"""Large pictures are denoised in tiles that leave no seam."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from simnfnd.models.denoise.denoiser import Denoiser, starts, tiled
from tests.small_dataset import fan_images


@given(st.integers(1, 400), st.integers(8, 64), st.data())
def test_tiles_cover_every_pixel_and_share_enough(
    size: int, tile: int, data: st.DataObject
) -> None:
    overlap = data.draw(st.integers(0, tile // 2))
    found = starts(size, tile, overlap)
    assert found[0] == 0
    assert found[-1] + tile >= size
    assert size <= tile or found[-1] + tile == size
    for first, second in pairwise(found):
        assert overlap <= first + tile - second < tile


def test_tiles_leave_no_seam() -> None:
    rng = np.random.default_rng(0)
    image = rng.random((90, 130)).astype(np.float32)
    scale = {"scale": np.linspace(0, 1, 90 * 130, dtype=np.float32).reshape(90, 130)}

    def local(part: npt.NDArray[np.float32], maps: Any) -> npt.NDArray[np.float32]:
        # What a network with a small field of view does: pixels and their neighbours.
        return np.asarray(ndimage.uniform_filter(part, 5, mode="nearest") * maps["scale"])

    whole, parts = local(image, scale), tiled(local, image, scale, 48, 20)
    np.testing.assert_allclose(parts[3:-3, 3:-3], whole[3:-3, 3:-3], atol=0.02)
    middle = np.abs(parts - whole)[3:-3, 3:-3]
    assert np.median(middle) < 1e-6

    def brightening(part: npt.NDArray[np.float32], maps: Any) -> npt.NDArray[np.float32]:
        # Each tile comes out brighter than the one before: the worst seam that there could be.
        brightening.calls += 1  # type: ignore[attr-defined]
        return np.full(part.shape, brightening.calls, np.float32)  # type: ignore[attr-defined]

    brightening.calls = 0  # type: ignore[attr-defined]
    blended = tiled(brightening, np.zeros((40, 200), np.float32), {}, 60, 20)
    assert np.abs(np.diff(blended, axis=1)).max() <= 1.01 / 20
    with pytest.raises(ValueError, match="half of the tile"):
        tiled(local, image, scale, 32, 20)


def test_large_pictures_are_denoised_in_tiles(weights: Path) -> None:
    noisy, _, _ = fan_images(96, np.random.default_rng(2))
    denoise = Denoiser(weights, "cpu")
    whole = denoise(noisy)
    denoise.tile, denoise.overlap = 64, 24
    parts = denoise(noisy)
    # NAFNet's attention is a mean over the tile, so a little differs.
    assert np.abs(whole - parts).max() < 0.05
    assert parts.dtype == np.float32
