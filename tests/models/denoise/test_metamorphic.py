"""Changes of one part of a real image that must not change what is left of the grain elsewhere.

Samples: a DIDSON frame and a part of an ARIS frame.  Grain is what is left of the mean of four
neighbours where the scene is flat; its share that the weights leave is compared with that in the
image as it was recorded.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
import pytest

from simnfnd import open_recording
from simnfnd.factory.common.array_types import Array, Bools
from simnfnd.models.denoise.denoiser import Denoiser
from tests.project_files import ROOT

_MOST = 0.15
"""The share of grain that is left may change by this part of it."""
_NEAR = slice(60, None)
"""Rows of the samples that are measured: those far from the band and the letters."""


class Sample(NamedTuple):
    """image: (H, W) uint8.  flat: (H, W), where the scene has no edges."""

    image: Array
    flat: Bools


@lru_cache(maxsize=2)
def sample(name: str) -> Sample:
    """200 x 160 pixels amid the fan, and where the mean of all frames is flat there."""
    path = {"didson": "examples/didson/lamprey.avi", "aris": "examples/aris/sample.aris"}[name]
    with open_recording(ROOT / path) as recording:
        count = min(len(recording), 4)
        frames = np.stack([np.float32(recording[number].image) for number in range(count)])
    if frames.ndim == 4:
        frames = frames[..., 0]
    if frames.max() <= 1:
        frames = frames * 255
    top, left = (
        (side - size) // 2 for side, size in zip(frames.shape[1:], (200, 160), strict=True)
    )
    frames = frames[:, top : top + 200, left : left + 160]
    mean = cv2.GaussianBlur(frames.mean(axis=0), (0, 0), 3)
    slope = np.hypot(*np.gradient(mean)) / np.maximum(mean, 1)
    lit = mean > 12
    flat = lit & (slope < np.quantile(slope[lit], 0.5))
    return Sample(np.rint(frames[0]).astype(np.uint8), flat)


@lru_cache(maxsize=1)
def denoiser() -> Denoiser:
    return Denoiser("simnfnd", "cpu")


def grain(image: Array, flat: Bools) -> float:
    kernel = np.array([[0, -0.25, 0], [-0.25, 1, -0.25], [0, -0.25, 0]], np.float32)
    return float(cv2.filter2D(image.astype(np.float32), -1, kernel)[flat].std())


def share_left(image: Array, flat: Bools) -> float:
    """Of the grain of (H, W) uint8, after the weights that ship."""
    levels = image.astype(np.float32) / 255
    denoised = denoiser()(levels)
    return grain(denoised, flat) / grain(levels, flat)


def with_gain(image: Array) -> Array:
    weakened: Array = np.rint(0.6 * image).astype(np.uint8)
    return weakened


def with_distant_band(image: Array) -> Array:
    """Three times as bright in the far sixth of the rows."""
    changed = image.astype(np.float32)
    changed[:35] *= 3
    return np.clip(changed, 0, 255).astype(np.uint8)


def with_letters(image: Array) -> Array:
    changed = image.copy()
    for left in range(6, 66, 8):
        changed[8:18, left : left + 5] = 255
    return changed


@pytest.mark.parametrize("name", ["didson", "aris"])
@pytest.mark.parametrize("change", [with_gain, with_distant_band, with_letters])
def test_what_is_left_of_the_grain_elsewhere_stays(
    name: str, change: Callable[[Array], Array]
) -> None:
    image, flat = sample(name)
    measured = flat.copy()
    measured[: _NEAR.start] = False
    before = share_left(image, measured)
    assert share_left(change(image), measured) == pytest.approx(before, rel=_MOST)


@pytest.mark.parametrize("name", ["didson", "aris"])
def test_a_mirrored_image_keeps_as_much_grain(name: str) -> None:
    image, flat = sample(name)
    mirrored = np.ascontiguousarray(image[:, ::-1])
    share = share_left(mirrored, flat[:, ::-1])
    assert share == pytest.approx(share_left(image, flat), rel=_MOST)


@pytest.mark.parametrize("name", ["didson", "aris"])
def test_a_crop_keeps_as_much_grain(name: str) -> None:
    image, flat = sample(name)
    part = np.s_[32:-32, 22:-22]
    inner = np.zeros_like(flat)
    inner[48:-48, 38:-38] = flat[48:-48, 38:-38]
    share = share_left(np.ascontiguousarray(image[part]), inner[part])
    assert share == pytest.approx(share_left(image, inner), rel=_MOST)
