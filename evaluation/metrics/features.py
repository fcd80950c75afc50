"""A polar image in numbers: levels, speckle, and what lies along beams and rows."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import fft

from ...factory.common.array_types import Float64s, Floats
from .measure import Grey

SIDE = 16
"""Edge of a window in cells of the polar grid."""
_PART = 4  # edge of the parts of a window, cells
_SHARE = 0.2  # share of the windows that count as even
_DARKEST = 0.02  # mean grey value of a window below which it is clipped to black

_SMOOTH = 31  # side of the window whose mean and deviation are taken out of the grain, cells
_LAGS = 24  # lags of the autocorrelation

# One grey step of 8 bits: where a level in dB is needed, black counts as this.
_STEP = 1 / 255


FEATURES = {
    "dark": "level, darkest tenth",
    "middle": "level, median",
    "bright": "level, brightest tenth",
    "edges": "mean gradient",
    "enl": "ENL",
    "si": "scintillation index",
    "grain_range": "grain along range, cells",
    "grain_bearing": "grain along bearing, cells",
    "spoke": "spoke index",
    "arc": "arc index",
    "slope": "range slope, dB/window",
    "slope_per_m": "range slope, dB/m",
    "highlight": "highlight contrast, dB",
    "shadow": "shadow contrast, dB",
}
"""Name -> what tables call it; `docs/realism.md` defines each."""


def features_of(polar: Grey, span_m: float | None = None) -> dict[str, float]:
    """The features of a polar image in 0..1; NaN where one does not exist.

    span_m: length of its range window in metres; without it there is no slope per metre.
    """
    slope_db = range_slope_db(polar)
    along = cv2.Sobel(polar, cv2.CV_32F, 0, 1, scale=1 / 8)
    across = cv2.Sobel(polar, cv2.CV_32F, 1, 0, scale=1 / 8)
    dark, middle, bright = np.quantile(polar, (0.1, 0.5, 0.9))
    return {
        "dark": float(dark),
        "middle": float(middle),
        "bright": float(bright),
        "edges": float(np.hypot(along, across).mean()),
        **dict(zip(("enl", "si"), speckle(polar), strict=True)),
        **dict(zip(("grain_range", "grain_bearing"), half_widths(polar), strict=True)),
        "spoke": spread_of_means(polar, 0),
        "arc": spread_of_means(polar, 1),
        "slope": slope_db,
        "slope_per_m": slope_db / span_m if span_m else float("nan"),
        **dict(zip(("highlight", "shadow"), contrasts_db(polar), strict=True)),
    }


def even_windows(polar: Floats) -> Float64s:
    """(N, SIDE * SIDE) grey values of the evenest fifth of the windows; (0, ...) if all is black.

    Windows lie on a grid without overlap; those with a mean below 2 % of full scale (clipped to
    black) do not count, nor do constant ones.  A window is even when the means of its 4x4 parts
    differ little for the scatter within the parts: that asks for a flat bottom, and not for weak
    speckle, as the lowest std/mean would.
    """
    rows, columns = (size // SIDE for size in polar.shape)
    cut = np.asarray(polar[: rows * SIDE, : columns * SIDE], dtype=np.float64)
    blocks = cut.reshape(rows, SIDE, columns, SIDE).transpose(0, 2, 1, 3).reshape(-1, SIDE, SIDE)
    parts = blocks.reshape(-1, SIDE // _PART, _PART, SIDE // _PART, _PART).mean(axis=(2, 4))
    mean = blocks.mean(axis=(1, 2))
    between = parts.var(axis=(1, 2))
    within = blocks.var(axis=(1, 2)) - between
    usable = np.flatnonzero((mean >= _DARKEST) & (within > 1e-9))
    unevenness = between[usable] / within[usable]
    count = max(1, round(_SHARE * usable.size)) if usable.size else 0
    chosen = usable[np.argsort(unevenness, kind="stable")[:count]]
    return np.asarray(blocks[chosen].reshape(count, SIDE * SIDE))


def speckle(polar: Floats) -> tuple[float, float]:
    """Medians over the even windows of ENL and scintillation index; NaN without any.

    Grey values g are taken as amplitude: ENL = (mean / std)^2 and SI = <g^4> / <g^2>^2 - 1.
    Rayleigh amplitude has ENL 3.66 and SI 1; what a display makes of it (compression) has other
    values, the same on both sides of the comparison.
    """
    windows = even_windows(polar)
    if not len(windows):
        return float("nan"), float("nan")
    cv = windows.std(axis=1) / windows.mean(axis=1)
    power = windows**2
    index = (power**2).mean(axis=1) / power.mean(axis=1) ** 2 - 1
    return float(np.median(1 / np.maximum(cv, 1e-6) ** 2)), float(np.median(index))


def half_widths(polar: Grey) -> tuple[float, float]:
    """Lags along range and bearing, in cells, where the speckle's autocorrelation is one half.

    Structure larger than 31 cells is removed first: by subtracting the local mean and dividing by
    the local standard deviation.  NaN for an image without any variation.
    """
    grain = grain_of(polar)
    first, second = (_half(autocorrelation(grain, axis)) for axis in (0, 1))
    return first, second


def grain_of(polar: Grey) -> Grey:
    """The speckle alone: the local mean subtracted, over the local standard deviation."""
    mean = cv2.blur(polar, (_SMOOTH, _SMOOTH))
    residual = polar - mean
    spread = np.sqrt(np.maximum(cv2.blur(residual**2, (_SMOOTH, _SMOOTH)), 0))
    return np.asarray(np.where(spread > 1e-3, residual / np.maximum(spread, 1e-3), 0))


def autocorrelation(grain: Grey, axis: int) -> Float64s:
    """Autocorrelation at lags 0, 1, ... along an axis, each over the pairs that exist."""
    size = grain.shape[axis]
    power = np.abs(fft.rfft(grain, 2 * size, axis=axis)) ** 2
    raw = fft.irfft(power.sum(axis=1 - axis), 2 * size)[: min(_LAGS, size - 1)]
    return np.asarray(raw / (size - np.arange(len(raw))), dtype=np.float64)


def _half(correlation: Float64s) -> float:
    if correlation[0] <= 0:
        return float("nan")
    values = correlation / correlation[0]
    below = np.flatnonzero(values < 0.5)
    if not below.size:
        return float(len(values))
    lag = int(below[0])
    return float(lag - 1 + (values[lag - 1] - 0.5) / (values[lag - 1] - values[lag]))


def spread_of_means(polar: Grey, axis: int) -> float:
    """Variance of the means along an axis over that of the image; NaN when all is equal.

    Axis 0 gives the beams' means (spokes), axis 1 the range rows' (arcs).
    """
    values = polar.astype(np.float64)
    total = float(values.var())
    return float(values.mean(axis=axis).var()) / total if total > 1e-12 else float("nan")


def range_slope_db(polar: Grey) -> float:
    """Slope of the level along range: dB from the near to the far end of the window.

    Least squares on 20 log10 of the mean grey value of each range row.  For dB/m divide by the
    length of the window.
    """
    level_db = 20 * np.log10(np.maximum(polar.mean(axis=1, dtype=np.float64), _STEP))
    position = (np.arange(len(level_db)) + 0.5) / len(level_db)
    return float(np.polyfit(position, level_db, 1)[0])


def contrasts_db(polar: Grey) -> tuple[float, float]:
    """Highlight over background and background over shadow, dB.

    Of means of 5x5 cells, so that speckle counts for less: the 99.5th percentile over the median,
    and the median over the 1st percentile.
    """
    low, middle, high = np.percentile(cv2.blur(polar, (5, 5)), [1, 50, 99.5])
    background = max(float(middle), _STEP)
    return (
        20 * float(np.log10(max(float(high), _STEP) / background)),
        20 * float(np.log10(background / max(float(low), _STEP))),
    )
