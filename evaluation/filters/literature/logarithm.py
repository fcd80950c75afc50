"""In the logarithm, where speckle is additive: filters of one look, and the mean of several."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from ..base import Gray

Floats = npt.NDArray[np.float32]

_FLOOR = 1 / 255  # one grey level: the logarithm of black


def in_logarithm(image: Gray, smoothed: Callable[[Floats], Floats]) -> Gray:
    """(H, W) in 0..1 denoised by `smoothed`, which maps a picture of logarithms to the same shape.

    Black is exactly 0 in the logarithm, so that there is nothing outside of a fan.
    """
    logarithm = np.log(np.maximum(image / np.float32(_FLOOR), 1)).astype(np.float32)
    smooth = np.exp(smoothed(logarithm))
    result = np.maximum(smooth - 1, 0) * np.float32(_FLOOR / (1 - _FLOOR))
    # The exponential of a mean of logarithms lies below the mean.
    return np.asarray(result * _ratio(float(image.mean()), float(result.mean())), np.float32)


def _ratio(wanted: float, have: float) -> np.float32:
    return np.float32(wanted / have) if have > 1e-9 else np.float32(1)


def recursive_least_squares(image: Gray, memory: float) -> Gray:
    """Recursive least squares of a constant, per pixel, in the logarithm; (T, H, W) -> (H, W).

    memory: the forgetting factor lambda in (0, 1].  The gain of look t is 1 / (1 + lambda + ... +
    lambda^(t-1)), so 1 is the geometric mean of all looks, and with one look the result is that
    look.  Multiplicative noise is additive in the logarithm.
    """
    estimate = np.log(np.maximum(image[0].astype(np.float64), _FLOOR))
    gain_sum = 1.0
    for look in image[1:]:
        gain_sum = memory * gain_sum + 1
        estimate += (np.log(np.maximum(look.astype(np.float64), _FLOOR)) - estimate) / gain_sum
    level = np.exp(estimate)
    return np.asarray(np.where(level <= _FLOOR * 1.000001, 0, level), dtype=np.float32)
