"""How large deviations between frames are by noise alone, measured in the recording itself."""

from __future__ import annotations

import numpy as np

from ....factory.common.array_types import Array, Float64s

_LEVELS = 32  # classes of grey value, even in its root: a dark image has several, too
_MIN_PIXELS = 20  # of a class in one frame
_MIN_SIGMA = 0.0015
_NORMAL = 1.4826  # from the median of absolute values to a standard deviation
_STRIDE = 3  # of the pixels that are measured
_KERNEL = np.array([1.0, 2, 3, 2, 1])  # neighbouring classes share their measurements
_MAX_MEMORY = 20  # frames that a running mean goes back


class NoiseByLevel:
    """Standard deviation of some deviation by grey level: robust, the mean over frames."""

    def __init__(self) -> None:
        self._weighted_sigma = np.zeros(_LEVELS)
        self._pixels = np.zeros(_LEVELS)
        self._table: Array | None = None

    def add(self, deviation: Array, grey: Array) -> None:
        """Measure deviations, (h, w), at pixels of grey values in 0..1, (h, w)."""
        from . import kernels  # loads numba

        medians, counts = kernels.medians_by_level(deviation, grey, _LEVELS, _STRIDE, _MIN_PIXELS)
        self._weighted_sigma += _NORMAL * medians * counts
        self._pixels += counts
        self._table = None

    def at(self, grey: Array) -> Array:
        """Standard deviation, float32, at grey values in 0..1, (h, w) or (h, w, channels)."""
        from . import kernels  # loads numba

        if self._table is None:
            self._table = self._levels_table()
        flat = grey.reshape(len(grey), -1)
        return np.asarray(kernels.by_root_level(flat, self._table).reshape(grey.shape))

    def _levels_table(self) -> Array:
        """Standard deviation at 256 grey values, even in their root."""
        known = self._pixels > 0
        if not known.any():
            return np.full(256, _MIN_SIGMA, np.float32)
        middles = (np.arange(_LEVELS) + 0.5) / _LEVELS
        sigma = np.interp(
            middles, middles[known], self._weighted_sigma[known] / self._pixels[known]
        )
        pixels = np.interp(middles, middles[known], self._pixels[known])
        power: Float64s = np.convolve(np.pad(sigma**2 * pixels, 2, mode="edge"), _KERNEL, "valid")
        power = power / np.convolve(np.pad(pixels, 2, mode="edge"), _KERNEL, "valid")
        fine = np.interp(np.linspace(0, 1, 256), middles, np.sqrt(power))
        return np.maximum(fine, _MIN_SIGMA).astype(np.float32)


class RunningSpread:
    """Median of a value and its robust standard deviation, averaged over frames."""

    def __init__(self) -> None:
        self._median = 0.0
        self._sigma = 0.0
        self._frames = 0

    def standardise(self, values: Array, measured: Array) -> Array:
        """(h, w): values in standard deviations above their median.

        measured: (h, w) bool, the pixels that are measured; with fewer than 20 of them nothing is.
        """
        sample = values[measured][::_STRIDE]
        if len(sample) >= _MIN_PIXELS:
            self._frames += 1
            share = 1 / min(self._frames, _MAX_MEMORY)
            median = float(np.median(sample))
            sigma = _NORMAL * float(np.median(np.abs(sample - median)))
            self._median += share * (median - self._median)
            self._sigma += share * (sigma - self._sigma)
        if self._sigma <= 0:
            return np.zeros_like(values)
        return (values - np.float32(self._median)) / np.float32(self._sigma)
