"""Speckle made additive: logarithm, a filter of additive noise, exponential, mean corrected."""

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
