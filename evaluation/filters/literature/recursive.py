"""Several looks at one scene, averaged as they come."""

from __future__ import annotations

import numpy as np

from ..base import Gray

_FLOOR = 1 / 255  # one grey level: the logarithm of black


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
