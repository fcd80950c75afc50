"""Grain and texture of a polar picture: autocorrelation, spectra, gradients, local patterns."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import fft

Gray = npt.NDArray[np.float32]
Values = npt.NDArray[np.float64]

SPECTRUM_BINS = 24
"""Bins of every spectrum, equal steps from 0 to 0.5 cycles a cell (0 itself is left out)."""
GRADIENT_BINS = 64
PATTERNS = 10
_SMOOTH = 31
_LAGS = 24


def half_widths(polar: Gray) -> tuple[float, float]:
    """Lags along range and bearing, in cells, where the speckle's autocorrelation is one half.

    What is larger than 31 cells is taken out first: the local mean is subtracted and the local
    standard deviation divides.  NaN for a picture without any variation.
    """
    import cv2

    mean = cv2.blur(polar, (_SMOOTH, _SMOOTH))
    residual = polar - mean
    spread = np.sqrt(np.maximum(cv2.blur(residual**2, (_SMOOTH, _SMOOTH)), 0))
    grain = np.where(spread > 1e-3, residual / np.maximum(spread, 1e-3), 0)
    correlation = [_correlation(grain, axis) for axis in (0, 1)]
    first, second = (_half(values) for values in correlation)
    return first, second


def _correlation(grain: Gray, axis: int) -> Values:
    """Autocorrelation at lags 0, 1, ... along an axis, each over the pairs that exist."""
    size = grain.shape[axis]
    power = np.abs(fft.rfft(grain, 2 * size, axis=axis)) ** 2
    raw = fft.irfft(power.sum(axis=1 - axis), 2 * size)[: min(_LAGS, size - 1)]
    return np.asarray(raw / (size - np.arange(len(raw))), dtype=np.float64)


def _half(correlation: Values) -> float:
    if correlation[0] <= 0:
        return float("nan")
    values = correlation / correlation[0]
    below = np.flatnonzero(values < 0.5)
    if not below.size:
        return float(len(values))
    lag = int(below[0])
    return float(lag - 1 + (values[lag - 1] - 0.5) / (values[lag - 1] - values[lag]))


def spectra(polar: Gray) -> tuple[Values, Values, Values]:
    """Power spectra, radial, along range and along bearing: (SPECTRUM_BINS,) each, in dB.

    Of the picture less its mean, under a Hann window; each is relative to its own total power, so
    brightness does not count.
    """
    rows, columns = polar.shape
    taper = np.hanning(rows)[:, None] * np.hanning(columns)[None, :]
    power = np.abs(fft.rfft2((polar - polar.mean()) * taper)) ** 2
    # Every frequency but 0 and the highest along the last axis stands for its mirror image, too.
    power[:, 1 : (columns + 1) // 2] *= 2
    along = np.abs(fft.fftfreq(rows))[:, None]
    across = fft.rfftfreq(columns)[None, :]
    radius = np.hypot(along, across)
    along, across = np.broadcast_to(along, power.shape), np.broadcast_to(across, power.shape)
    radial, by_range, by_bearing = (_binned(power, f) for f in (radius, along, across))
    return radial, by_range, by_bearing


def _binned(power: Values, frequency: Values) -> Values:
    place = np.floor(frequency * (2 * SPECTRUM_BINS)).astype(np.intp)
    inside = (place < SPECTRUM_BINS) & (frequency > 0)
    sums = np.bincount(place[inside], weights=power[inside], minlength=SPECTRUM_BINS)
    counts = np.bincount(place[inside], minlength=SPECTRUM_BINS)
    # Means, for a bin may hold one frequency more than its neighbour.
    density = sums / np.maximum(counts, 1)
    share = density / max(float(density.sum()), 1e-30)
    return np.asarray(10 * np.log10(np.maximum(share, 1e-8)))


def gradients(polar: Gray) -> Values:
    """(GRADIENT_BINS,) histogram (counts) of the Sobel gradient's magnitude, 0 to 0.5 a cell."""
    import cv2

    along = cv2.Sobel(polar, cv2.CV_32F, 0, 1, scale=1 / 8)
    across = cv2.Sobel(polar, cv2.CV_32F, 1, 0, scale=1 / 8)
    place = np.minimum(np.hypot(along, across) * (2 * GRADIENT_BINS), GRADIENT_BINS - 1)
    return np.bincount(place.astype(np.intp).ravel(), minlength=GRADIENT_BINS).astype(np.float64)


def patterns(polar: Gray) -> Values:
    """(PATTERNS,) histogram (counts) of local binary patterns, 8 neighbours, rotation invariant.

    Ojala, Pietikainen and Maenpaa 2002, "uniform" patterns: 0 to 8 brighter neighbours in one arc,
    the last bin for all others.
    """
    from skimage.feature import local_binary_pattern as pattern

    # Of grey steps: equal grey values count as brighter, which rounding must not decide.
    grey = np.rint(polar * 255).astype(np.uint8)
    codes = np.asarray(pattern(grey, 8, 1, method="uniform"))  # type: ignore[no-untyped-call]
    return np.bincount(codes.astype(np.intp).ravel(), minlength=PATTERNS).astype(np.float64)
