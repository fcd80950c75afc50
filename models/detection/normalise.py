"""Grey values as the network sees them: without gain, gamma and the trend over range.

Real and simulated images differ in display.  The wide local mean of the logarithm is subtracted,
which removes a gain that varies slowly; ranks then remove the display curve.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy.special import ndtri

from ...factory.common.array_types import Bools, Float32s

CHANNELS = 3

_WIDE_PX = 41  # side of the window whose mean is subtracted
_NARROW_PX = 17  # side of the window of the local contrast
_DARKEST = 0.02  # added before the logarithm, as a share of full scale
_GREATEST_CONTRAST = 3.0  # standard deviations
_LEVELS = 1024


def normalise(image: Float32s, is_fan: Bools) -> Float32s:
    """(3, H, W) float32: grey value in -1..1, local contrast in -1..1, and the fan as 0 or 1.

    image: (H, W) >= 0.  is_fan: (H, W) bool; outside it all channels are 0.
    """
    fan = is_fan.astype(np.float32)
    logarithm = np.log(image + np.float32(_DARKEST)) * fan
    level = logarithm - _local_mean(logarithm, fan, _WIDE_PX)
    # A normal distribution of grey values keeps the differences between bright echoes.
    deviate = ndtri(_rank(level, is_fan)) / _GREATEST_CONTRAST
    grey = np.clip(deviate, -1, 1).astype(np.float32) * fan
    contrast = _local_contrast(grey, fan) * fan
    return np.stack([grey, contrast, fan])


def _rank(values: Float32s, is_fan: Bools) -> Float32s:
    """The share of the pixels of the fan that are darker, (H, W) in 0..1, both exclusive."""
    inside = values[is_fan]
    if not inside.size:
        return np.full_like(values, 0.5)
    low = inside.min()
    step = max(float(inside.max() - low), 1e-6) / (_LEVELS - 1)
    levels = np.clip((values - low) / step, 0, _LEVELS - 1).astype(np.int32)
    counts = np.bincount(levels[is_fan], minlength=_LEVELS).astype(np.float64)
    shares = ((np.cumsum(counts) - counts / 2) / counts.sum()).astype(np.float32)
    return np.asarray(shares[levels], np.float32)


def _local_contrast(grey: Float32s, fan: Float32s) -> Float32s:
    """(grey - local mean) / local deviation of the smoothed image, clipped, in -1..1."""
    smooth = np.asarray(cv2.GaussianBlur(grey, (0, 0), 1.0), np.float32)
    mean = _local_mean(smooth, fan, _NARROW_PX)
    square = _local_mean(smooth * smooth, fan, _NARROW_PX)
    deviation = np.sqrt(np.maximum(square - mean * mean, 0)) + 0.02
    contrast = (smooth - mean) / (deviation * _GREATEST_CONTRAST)
    return np.asarray(np.clip(contrast, -1, 1), np.float32)


def _local_mean(values: Float32s, fan: Float32s, side_px: int) -> Float32s:
    """Mean of the pixels of the fan in a square window, (H, W)."""
    size = (side_px, side_px)
    return np.asarray(cv2.blur(values * fan, size) / (cv2.blur(fan, size) + 1e-6), np.float32)
