"""Less total variation, by as much as each pixel's noise asks for."""

from __future__ import annotations

import math

import numpy as np

from ...factory.common.array_types import Array, Float32s

_LEAST_WEIGHT = np.float32(1e-4)
_EIGHTH = np.float32(0.125)  # over the weight: the longest step with which the dual converges


def less_total_variation(grey: Array, weight: Array, steps: int) -> Float32s:
    """The image with less total variation, (H, W).

    grey: (H, W).  weight: (H, W), how much less, in grey values.
    Fast gradient projection of the dual (Beck and Teboulle 2009), isotropic, a number of steps.
    """
    from .temporal import kernels  # loads numba

    weight = np.maximum(weight, _LEAST_WEIGHT)
    step = _EIGHTH / weight
    image = np.empty_like(weight)
    across, down, previous_across, previous_down = np.zeros((4, *grey.shape), np.float32)
    momentum = 1.0
    for _ in range(steps):
        kernels.less_divergence(image, grey, across, down, weight)
        next_momentum = (1 + math.sqrt(1 + 4 * momentum * momentum)) / 2
        push = np.float32((momentum - 1) / next_momentum)
        kernels.step_dual(across, down, previous_across, previous_down, image, step, push)
        momentum = next_momentum
    kernels.less_divergence(image, grey, previous_across, previous_down, weight)
    return image
