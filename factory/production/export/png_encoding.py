"""Images as PNG files."""

from __future__ import annotations

import cv2
import numpy as np

from ...common.array_types import Array

# Level 1: a third of the time of the default, a few per cent larger.
_COMPRESSION = (cv2.IMWRITE_PNG_COMPRESSION, 1)
_MAX_UINT16 = 65535


def fits_png(dtype: np.dtype[np.generic]) -> bool:
    """Whether a PNG holds this type without loss."""
    return dtype in (np.bool_, np.uint8, np.uint16)


def encode_png(image: Array) -> bytes:
    """(H, W) uint8, uint16, bool (as 0 and 255) or float in 0..1 (16 bits), or RGB -> PNG."""
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)

    if image.dtype == np.bool_:
        image = image.astype(np.uint8) * np.uint8(255)
    elif not fits_png(image.dtype):
        image = np.rint(image.astype(np.float64) * _MAX_UINT16).astype(np.uint16)

    is_encoded, encoded = cv2.imencode(".png", image, _COMPRESSION)
    assert is_encoded  # only unknown types and empty images fail
    return encoded.tobytes()
