"""Speckle: how smooth are the smooth places, and is the mean kept?"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .fidelity import Image, Mask

Values = npt.NDArray[np.float64]

SIDE = 16
"""Of an even zone, pixels."""

_DARK = 0.01  # of full scale: below, a ratio says nothing


def homogeneous_zones(
    image: Image, *, data_range: float, sector: Mask, share: float = 0.1
) -> npt.NDArray[np.int64]:
    """(N, 2) top-left corners of the image's most even blocks, the evenest first.

    Blocks of 16x16 pixels on a grid without overlap, wholly inside `sector` and with a mean above
    5 % of full scale (shadow is even, too, but has no speckle); of these the `share` (at least one)
    with the least std/mean.  Choose them on the clean image where there is one, so that all methods
    are measured in the same places.  Empty when no block qualifies.
    """
    rows, columns = (size // SIDE for size in image.shape)

    def blocks(array: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        cut = array[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE)
        return cut.transpose(0, 2, 1, 3).reshape(rows * columns, SIDE * SIDE)

    values = blocks(image.astype(np.float64))
    mean, deviation = values.mean(axis=1), values.std(axis=1)
    (usable,) = np.nonzero(blocks(sector).all(axis=1) & (mean > 0.05 * data_range))
    if not usable.size:
        return np.empty((0, 2), dtype=np.int64)
    count = max(1, round(share * usable.size))
    order = np.argsort(deviation[usable] / mean[usable], kind="stable")[:count]
    chosen = usable[order]
    corners = np.stack([chosen // columns * SIDE, chosen % columns * SIDE], axis=1)
    return np.asarray(corners, dtype=np.int64)


def zone_enl(image: Image, zones: npt.NDArray[np.int64]) -> Values:
    """(N,) equivalent number of looks of each zone, mean^2 / variance; inf where all is equal."""
    offsets = np.arange(SIDE)
    rows, columns = zones[:, :1] + offsets, zones[:, 1:] + offsets
    blocks = image[rows[:, :, None], columns[:, None, :]].reshape(len(zones), -1).astype(float)
    squared, variance = blocks.mean(axis=1) ** 2, blocks.var(axis=1)
    # The variance of a constant is rounding alone.
    some = variance > 1e-20 * squared
    return np.where(some, squared / np.where(some, variance, 1.0), math.inf)


def enl(image: Image, zones: npt.NDArray[np.int64]) -> float:
    """Median ENL over the zones (NaN without any).  Blur alone raises it: never read it alone."""
    return float(np.median(zone_enl(image, zones))) if len(zones) else math.nan


def contrast_to_noise(image: Image, bright: Mask, dark: Mask) -> float:
    """CNR of two regions, |m1 - m2| / sqrt(v1 + v2) with population variances (linear, not dB).

    Here `bright` is the insonified seabed and `dark` the true shadow.  NaN when a region is empty,
    inf when both are constant and differ.
    """
    gray = np.asarray(image, dtype=np.float64)
    one, other = gray[bright], gray[dark]
    if not one.size or not other.size:
        return math.nan
    difference = abs(float(one.mean() - other.mean()))
    noise = math.sqrt(float(one.var() + other.var()))
    if noise == 0:
        return math.inf if difference else 0.0
    return difference / noise


def mean_ratio(noisy: Image, denoised: Image) -> float:
    """Mean of noisy / denoised, images in 0..1, where denoised is at least 1 % of full scale.

    1 = the mean is kept; NaN where nothing is bright enough.
    """
    below = denoised.astype(np.float64)
    lit = below >= _DARK
    return float((noisy[lit].astype(np.float64) / below[lit]).mean()) if lit.any() else math.nan
