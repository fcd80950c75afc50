"""Saturated echoes keep their level: where a receiver clips, an image has no noise to remove.

A network that never saw a flat patch of white takes it for ground and darkens it.  What is clipped
and even in a small window is put back as it was.
"""

from __future__ import annotations

import cv2
import numpy as np

from ...factory.common.array_types import Float32s

_NEAR_WHITE = np.float32(0.98)  # of the largest grey value: codecs change clipped samples a little
_SIDE_PX = 5  # of a square that must be clipped
_BRIGHT = 0.02  # from this grey value on the brightest echoes are surely no darkness
_OF_LARGEST = 0.4
"""Median of lit pixels, by the largest: more is darkness, whose few levels make flat squares."""


def with_saturated(denoised: Float32s, levels: Float32s) -> Float32s:
    """A denoised image with the saturated echoes of the noisy one, (H, W) or (H, W, C) in 0..1.

    An echo counts as saturated where a square of `_SIDE_PX` is as bright as the brightest pixel.
    """
    largest = levels.max()
    if largest < _BRIGHT and not _has_contrast(levels, largest):
        return denoised
    clipped = levels >= _NEAR_WHITE * largest
    if np.count_nonzero(clipped) < _SIDE_PX * _SIDE_PX:
        return denoised
    square = np.ones((_SIDE_PX, _SIDE_PX), np.uint8)
    saturated = cv2.morphologyEx(
        clipped.astype(np.uint8), cv2.MORPH_OPEN, square, borderType=cv2.BORDER_REPLICATE
    )
    return np.where(saturated > 0, np.maximum(denoised, levels), denoised)


def _has_contrast(levels: Float32s, largest: np.float32) -> bool:
    """Whether a dark image, such as one of 10 bits in samples of 16, shows more than darkness."""
    lit = levels[levels > 0]
    return len(lit) > 0 and float(np.median(lit)) < _OF_LARGEST * float(largest)
