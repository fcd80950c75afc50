"""How wide the grain of an image is, measured where nothing else decides.

Ground that varies, letters and the edges of bright bands correlate neighbouring pixels, too.  They
raise the correlation where they are.  It is therefore measured in blocks, of which the lower
quartile counts.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from ...factory.common.array_types import Float32s

_BLOCK_PX = 32  # side of a block
_AROUND_PX = 9  # side of the mean that grain is measured against
_LEAST_COUNTED = 0.7  # part of a block's pixels that are neither black nor saturated
_SATURATED = 0.98
_LEAST_LEVEL = np.float32(1e-3)
_QUANTILE = 0.25


def grain_correlation(grey: Float32s) -> float:
    """Correlation of the grain of pixels that are neighbours along rows or columns, the lesser.

    grey: (H, W), 0 to 1.  The grain is the image less its local level, over that level, so a gain
    over part of the image changes nothing.
    Returns 0 where fewer than two blocks are lit, or where there is no grain.
    """
    is_echo = ((grey > 0) & (grey < _SATURATED)).astype(np.uint8)
    counted = cv2.erode(is_echo, np.ones((3, 3), np.uint8)).astype(np.float32)
    level = cv2.blur(grey, (_AROUND_PX, _AROUND_PX))
    grain = (grey - level) / np.maximum(level, _LEAST_LEVEL) * counted
    power = _block_means(grain * grain)
    is_usable = (_block_means(counted) > _LEAST_COUNTED) & (power > 0)
    if np.count_nonzero(is_usable) < 2:
        return 0.0

    covariance = neighbour_covariance(grain, _block_means)
    return float(np.quantile(covariance[is_usable] / power[is_usable], _QUANTILE))


def neighbour_covariance(grain: Float32s, local_mean: Callable[[Float32s], Float32s]) -> Float32s:
    """Covariance of pixels that are neighbours along rows or columns, the lesser.

    grain: (H, W), of mean 0.  local_mean: of a plane (H, W), in the shape that comes back.
    """
    down = np.zeros_like(grain)
    down[1:] = grain[1:] * grain[:-1]
    across = np.zeros_like(grain)
    across[:, 1:] = grain[:, 1:] * grain[:, :-1]
    return np.minimum(local_mean(down), local_mean(across))


def _block_means(plane: Float32s) -> Float32s:
    """Means of whole blocks, (H, W) -> (H // _BLOCK_PX, W // _BLOCK_PX)."""
    rows, columns = (side // _BLOCK_PX for side in plane.shape)
    whole = plane[: rows * _BLOCK_PX, : columns * _BLOCK_PX]
    if not whole.size:
        return np.zeros((rows, columns), np.float32)
    means = cv2.resize(whole, (columns, rows), interpolation=cv2.INTER_AREA)
    return np.asarray(means, np.float32)
