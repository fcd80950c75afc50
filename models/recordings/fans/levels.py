"""Grey values of an image, and the largest of them that count as black."""

from __future__ import annotations

import cv2
import numpy as np

from ....factory.common.array_types import Array, UInt8s
from ..palettes import find_painted
from .sector import Sector

MAX_BLACK = 48
"""Grey level of 255; a lighter border does not count as black."""


def grey_bytes(image: Array) -> UInt8s:
    """(H, W) of 8 bits: grey values, or the levels of a colour map.

    image: (H, W) or (H, W, colours) of any number type.  Raises ValueError for another shape.
    """
    if image.ndim == 3:
        painted = find_painted(image)
        image = image[..., :3].max(axis=2) if painted is None else painted.levels
    if image.ndim != 2:
        raise ValueError(f"image has shape {image.shape}; expected (H, W) or (H, W, colours)")
    if image.dtype == np.uint8:
        return image
    white = _white_level(image)
    # Rounded up, so that only zero becomes zero.
    return np.asarray(np.ceil(np.clip(np.nan_to_num(image / white), 0, 1) * 255), np.uint8)


def _white_level(image: Array) -> float:
    """The value of white: the largest of the type, 1 for floats, or the image's own maximum."""
    type_limit = float(np.iinfo(image.dtype).max) if image.dtype.kind in "iu" else 1.0
    # Samples of 10 or 12 bits in files of 16 leave most of the scale empty.
    brightest = float(np.nan_to_num(image, posinf=0).max(initial=0))
    return brightest if 0 < brightest < type_limit / 4 else type_limit


def black_level(grey: UInt8s) -> int:
    """Grey value of the darker upper corner: no fan reaches the corners, but text may."""
    side_px = max(2, min(grey.shape) // 40)
    left = grey[:side_px, :side_px]
    right = grey[:side_px, -side_px:]
    return min(int(np.quantile(corner, 0.99)) for corner in (left, right))


def ringing_level(grey: UInt8s, sector: Sector) -> int:
    """Grey value of the border beside a sector, where JPEG and MPEG ring and it is not black."""
    inside = sector.mask(*grey.shape)
    within_2_px = cv2.dilate(inside, np.ones((5, 5), np.uint8))
    within_8_px = cv2.dilate(inside, np.ones((17, 17), np.uint8))
    border = grey[(within_8_px > 0) & (within_2_px == 0)]
    if not border.size:
        return 0
    return min(int(np.quantile(border, 0.97)), MAX_BLACK)
