"""The way into the logarithm and back, where speckle is additive."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....factory.common.array_types import Float32s
from ...metrics.measure import Grey

_GREY_LEVEL = np.float32(1 / 255)


def denoise_logarithm(image: Grey, denoise: Callable[[Float32s], Float32s]) -> Grey:
    """(H, W) in 0..1, denoised in the logarithm, with the mean it had before.

    denoise: maps logarithms (H, W) of grey levels to the same shape.  Black is exactly 0 there, so
    nothing appears outside a fan.
    """
    logarithm = np.log(np.maximum(image / _GREY_LEVEL, 1)).astype(np.float32)
    levels = np.exp(denoise(logarithm))
    denoised = np.maximum(levels - 1, 0) * _GREY_LEVEL / (1 - _GREY_LEVEL)

    # The exponential of a mean of logarithms lies below the mean.
    mean = float(denoised.mean())
    gain = float(image.mean()) / mean if mean > 1e-9 else 1.0
    return np.asarray(denoised * np.float32(gain), np.float32)
