"""How large deviations between frames are by noise alone, measured in the window itself."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ....factory.common.array_types import Array, Float64s

_LEVELS = 32  # classes of grey value, even in its root: a dark image has several, too
_MIN_PIXELS = 20  # of a class
_MIN_SIGMA = 0.0015
_NORMAL = 1.4826  # from the median of absolute values to a standard deviation
_STRIDE = 3  # of the pixels that are measured
_KERNEL = np.array([1.0, 2, 3, 2, 1])  # neighbouring classes share their measurements
_MEASURED = 4  # frames of a window are enough to measure noise on


def some_of(count: int) -> list[int]:
    """Indices of the frames of a window that noise is measured on, evenly spread."""
    measured = min(count, _MEASURED)
    return [index * count // measured for index in range(measured)]


def noise_by_level(deviations: Sequence[Array], greys: Sequence[Array]) -> Array:
    """Standard deviation of deviations, (h, w) each, at 256 grey values, even in their root.

    greys: (h, w) grey values in 0..1 of the pixels; a pixel of 0 is left out of what is lit.
    """
    from . import kernels  # loads numba

    stacked = np.concatenate(deviations)
    stride = _STRIDE if stacked.size > _STRIDE**2 * _LEVELS * _MIN_PIXELS else 1
    medians, pixels = kernels.medians_by_level(
        stacked, np.concatenate(greys), _LEVELS, stride, _MIN_PIXELS
    )
    sigma = _NORMAL * medians
    known = pixels > 0
    if not known.any():
        return np.full(256, _MIN_SIGMA, np.float32)
    middles = (np.arange(_LEVELS) + 0.5) / _LEVELS
    sigma = np.interp(middles, middles[known], sigma[known])
    weights = np.interp(middles, middles[known], pixels[known])
    power: Float64s = np.convolve(np.pad(sigma**2 * weights, 2, mode="edge"), _KERNEL, "valid")
    power = power / np.convolve(np.pad(weights, 2, mode="edge"), _KERNEL, "valid")
    fine = np.interp(np.linspace(0, 1, 256), middles, np.sqrt(power))
    return np.maximum(fine, _MIN_SIGMA).astype(np.float32)


def at_level(grey: Array, table: Array) -> Array:
    """Entries of a table of `noise_by_level` at grey values, (h, w) or (h, w, channels)."""
    from . import kernels  # loads numba

    flat = grey.reshape(len(grey), -1)
    return np.asarray(kernels.by_root_level(flat, table).reshape(grey.shape))


def standardised(values: Array, measured: Array) -> Array:
    """(h, w): values in robust standard deviations above their median.

    measured: (h, w) bool, the pixels that are measured; zeros with fewer than 20 of them.
    """
    sample = values[measured][::_STRIDE]
    if len(sample) < _MIN_PIXELS:
        return np.zeros_like(values)
    median = float(np.median(sample))
    sigma = _NORMAL * float(np.median(np.abs(sample - median)))
    if sigma <= 0:
        return np.zeros_like(values)
    return (values - np.float32(median)) / np.float32(sigma)
