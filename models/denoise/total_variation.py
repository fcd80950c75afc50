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
    weight = np.maximum(weight, _LEAST_WEIGHT)
    step = _EIGHTH / weight
    across, down, next_across, next_down = np.zeros((4, *grey.shape), np.float32)
    slope_across, slope_down = np.zeros((2, *grey.shape), np.float32)
    momentum = 1.0
    # By NumPy alone: the last bit of OpenCV's sums of products depends on where arrays lie.
    for _ in range(steps):
        image = _primal(grey, across, down, weight)
        np.subtract(image[:, 1:], image[:, :-1], out=slope_across[:, :-1])
        np.subtract(image[1:], image[:-1], out=slope_down[:-1])
        across += slope_across * step
        down += slope_down * step

        length = np.sqrt(across * across + down * down)
        np.maximum(length, 1, out=length)
        across /= length
        down /= length

        next_momentum = (1 + math.sqrt(1 + 4 * momentum * momentum)) / 2
        push = np.float32((momentum - 1) / next_momentum)
        momentum = next_momentum
        # The dual with momentum, over the dual of the step before.
        next_across = across + push * (across - next_across)
        next_down = down + push * (down - next_down)
        across, next_across = next_across, across
        down, next_down = next_down, down
    # Without momentum.
    return _primal(grey, next_across, next_down, weight)


def _primal(grey: Array, across: Float32s, down: Float32s, weight: Float32s) -> Float32s:
    """The image (H, W) of a dual: the grey values and the divergence times the weight."""
    image = across + down
    image[:, 1:] -= across[:, :-1]
    image[1:] -= down[:-1]
    image *= weight
    image += grey
    return image
