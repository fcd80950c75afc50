"""From echo level to grey value: one curve for the clean and the noisy image, quantised last."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from ...common.array_types import Array, Float32s, Floats
from .settings import TransferSettings

# What a level is: decibels are 20 log10 of an amplitude, 10 log10 of an intensity.
Quantity = Literal["amplitude", "intensity"]
_DECIBELS = {"amplitude": 20, "intensity": 10}


def quantiles(values: Float32s, fractions: Sequence[float], *, skip: int = 0) -> list[float]:
    """The quantiles of (N,) float32 numbers, none of which is negative or NaN; N > skip.

    Between the values of the two nearest ranks, linearly, in double precision.
    skip: this many of the smallest do not count.
    """
    from ...common.elementary import ranked  # loads numba; a fifth of the time that sorting takes

    place = skip + np.asarray(fractions) * (len(values) - 1 - skip)
    below = place.astype(np.int64)
    ranks = np.stack([below, np.minimum(below + 1, len(values) - 1)])
    ranked_values = np.empty(ranks.shape, np.float32)
    ranked(np.ascontiguousarray(values, np.float32), ranks.ravel(), ranked_values.reshape(-1))
    low, high = ranked_values.astype(np.float64)
    between: list[float] = (low + (high - low) * (place - below)).tolist()
    return between


def full_scale(
    clean: Floats, transfer: TransferSettings, quantity: Quantity = "amplitude"
) -> float:
    """The echo level that becomes grey value 1, from the clean polar image.

    `transfer.percentile` of its echoing bins maps to grey value `transfer.reference`.
    """
    levels = np.asarray(clean, dtype=np.float32).reshape(-1)
    silent = levels.size - int(np.count_nonzero(levels != 0))  # ten times as fast as of the levels
    if silent == levels.size:
        return 1.0
    (level,) = quantiles(levels, (transfer.percentile / 100,), skip=silent)
    if transfer.kind == "log":
        headroom_db = (1 - transfer.reference) * transfer.dynamic_range_db
        return level * 10 ** (headroom_db / _DECIBELS[quantity])
    if transfer.kind == "soft_log":
        shown = (transfer.reference - transfer.black) / (1 - transfer.black)
        steps = 10 ** (transfer.dynamic_range_db / 10)
        intensity = float(np.expm1(shown * np.log1p(steps)) / steps)
        return level / float(intensity ** (_DECIBELS["intensity"] / _DECIBELS[quantity]))
    return level / transfer.reference ** (1 / transfer.exponent if transfer.kind == "power" else 1)


def grey(
    level: Floats,
    full_scale_level: float,
    transfer: TransferSettings,
    quantity: Quantity = "amplitude",
) -> Float32s:
    """Grey values in [0, 1], float32, same shape.

    log: y = clip((20 log10(A / A_ref) + DR) / DR, 0, 1) with DR = dynamic_range_db; 10 log10 of
    intensities, which the paper's points add up.
    soft_log: y = b + (1 - b) ln(1 + R I / I_ref) / ln(1 + R), R = 10^(DR / 10) and b = black.
    """
    relative = np.asarray(level, dtype=np.float32) / np.float32(full_scale_level)
    if transfer.kind == "log":
        per_decade = _DECIBELS[quantity]
        floor = 10 ** (-transfer.dynamic_range_db / per_decade)
        decibel = per_decade * np.log10(np.maximum(relative, floor))
        relative = 1 + decibel / transfer.dynamic_range_db
    elif transfer.kind == "soft_log":
        steps = np.float32(10 ** (transfer.dynamic_range_db / 10))
        intensity = relative if quantity == "intensity" else relative * relative
        shown = np.log1p(steps * intensity) / np.log1p(steps)
        relative = transfer.black + (1 - transfer.black) * shown
    elif transfer.kind == "power":
        relative = relative**transfer.exponent
    return np.clip(relative, 0, 1).astype(np.float32)


def level_db(
    grey_values: Floats,
    transfer: TransferSettings,
    quantity: Quantity = "amplitude",
) -> Float32s:
    """Levels over full scale that grey values in [0, 1] show, dB, same shape: `grey` backwards.

    Black is as far below full scale as the display, or 8 bits, can tell.
    """
    shown = np.clip(np.asarray(grey_values, np.float64), 0, 1)
    per_decade = _DECIBELS[quantity]
    if transfer.kind == "log":
        return np.asarray((shown - 1) * transfer.dynamic_range_db, np.float32)
    if transfer.kind == "soft_log":
        steps = 10 ** (transfer.dynamic_range_db / 10)
        above_black = np.maximum((shown - transfer.black) / (1 - transfer.black), 0)
        intensity = np.expm1(above_black * np.log1p(steps)) / steps
        return np.asarray(10 * np.log10(np.maximum(intensity, 1 / steps)), np.float32)
    exponent = transfer.exponent if transfer.kind == "power" else 1.0
    visible = np.maximum(shown, 0.5 / 255)
    return np.asarray(per_decade / exponent * np.log10(visible), np.float32)


def quantise(grey_values: Floats, dtype: str) -> Array:
    """uint8 (0 to 255, rounded) or float32 (0 to 1)."""
    if dtype == "uint8":
        return np.asarray(np.rint(grey_values * 255), dtype=np.uint8)
    # Interpolation between full-scale pixels rounds to a hair beyond 1.
    return np.clip(np.asarray(grey_values, dtype=np.float32), 0, 1)
