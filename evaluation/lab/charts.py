"""What the charts of the lab show of an image: grey values, radial spectrum, grain."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...factory.common.array_types import Float32s, Float64s, Floats, UInt8s
from ..metrics.features import autocorrelation, grain_of

_BINS = 64
_RINGS = 48
_LAGS = 24
_LEAST_SIDE = 16
_DECIMALS = 5


class Charts(NamedTuple):
    """The curves of one image.

    histogram: share of the pixels in each of 64 ranges of grey values; black ones do not count,
        for they fill the corners of a fan.
    spectrum_db: power in rings from 0 to half a cycle a pixel, over their mean, dB; of the middle
        half of rows and columns, which keeps the edges of the fan out.
    grain_rows, grain_columns: autocorrelation of the grain at lags of 0, 1, ... pixels, down and
        across the same part of the image.
    """

    histogram: list[float]
    spectrum_db: list[float]
    grain_rows: list[float]
    grain_columns: list[float]


def charts_of(grey: UInt8s) -> Charts:
    """The curves of an (H, W) image; those that it is too small for are empty."""
    lit = grey[grey > 0]
    counts = np.bincount(lit // (256 // _BINS), minlength=_BINS)
    histogram = _plain(counts / max(lit.size, 1))
    middle = _middle(grey)
    if min(middle.shape) < _LEAST_SIDE:
        return Charts(histogram, [], [], [])

    grain = grain_of(middle)
    rows, columns = (_normalised(autocorrelation(grain, axis)) for axis in (0, 1))
    return Charts(histogram, _plain(radial_spectrum_db(middle)), rows, columns)


def _middle(grey: UInt8s) -> Float32s:
    rows, columns = grey.shape
    middle = grey[rows // 4 : rows - rows // 4, columns // 4 : columns - columns // 4]
    return np.asarray(middle, np.float32) / np.float32(255)


def radial_spectrum_db(image: Float32s) -> Float64s:
    """(48,) power in rings of equal width up to half a cycle a pixel, over their mean, dB."""
    rings = _rings(*image.shape)
    power = np.abs(np.fft.rfft2((image - image.mean()) * rings.window)) ** 2
    sums = np.bincount(rings.of_frequency.ravel(), power.ravel(), minlength=_RINGS + 1)[:_RINGS]
    means = sums / rings.sizes
    return np.asarray(10 * np.log10(np.maximum(means / max(means.mean(), 1e-12), 1e-9)))


class _SpectralRings(NamedTuple):
    """Rings of equal width around frequency 0.

    window: (H, W) Hann window of the image.  of_frequency: (H, W // 2 + 1) number of the ring of
    each frequency, 48 beyond the last.  sizes: (48,) number of frequencies in each, at least 1.
    """

    window: Float32s
    of_frequency: npt.NDArray[np.intp]
    sizes: Float64s


@lru_cache(maxsize=4)
def _rings(rows: int, columns: int) -> _SpectralRings:
    """The rings of images of this many rows and columns."""
    window = np.outer(np.hanning(rows), np.hanning(columns)).astype(np.float32)
    cycles = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)[None, :])
    rings = np.minimum((cycles / 0.5 * _RINGS).astype(np.intp), _RINGS)
    sizes = np.bincount(rings.ravel(), minlength=_RINGS + 1)[:_RINGS]
    return _SpectralRings(window, rings, np.maximum(sizes, 1).astype(np.float64))


def _normalised(correlation: Float64s) -> list[float]:
    """1 at lag 0; empty for an image without any grain."""
    if correlation[0] <= 0:
        return []
    return _plain(correlation[:_LAGS] / correlation[0])


def _plain(values: Floats) -> list[float]:
    return [round(float(value), _DECIMALS) for value in values]
