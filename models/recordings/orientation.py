"""How stored pixels are to be turned before anybody looks at them.

Cameras and phones store pixels as their sensor gave them, and a tag beside them says which side is
up: the Exif orientation of an image, the display matrix of a video.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from ...factory.common.array_types import Array

EXIF_ORIENTATION = 274
"""Number of the Exif (and TIFF) tag."""

_MATRIX_BYTES = 36  # nine 32-bit integers


@dataclass(frozen=True)
class Orientation:
    """What turns stored pixels upright: transpose first, then reverse columns and rows."""

    is_transposed: bool = False
    reverses_columns: bool = False
    reverses_rows: bool = False

    def upright(self, pixels: Array) -> Array:
        """(H, W) or (H, W, C) as people should see it; a copy in one piece where it turns."""
        if self == UPRIGHT:
            return pixels
        if self.is_transposed:
            pixels = pixels.swapaxes(0, 1)
        if self.reverses_columns:
            pixels = pixels[:, ::-1]
        if self.reverses_rows:
            pixels = pixels[::-1]
        return np.ascontiguousarray(pixels)


UPRIGHT = Orientation()

_BY_EXIF = {
    2: Orientation(reverses_columns=True),
    3: Orientation(reverses_columns=True, reverses_rows=True),
    4: Orientation(reverses_rows=True),
    5: Orientation(is_transposed=True),
    6: Orientation(is_transposed=True, reverses_columns=True),
    7: Orientation(is_transposed=True, reverses_columns=True, reverses_rows=True),
    8: Orientation(is_transposed=True, reverses_rows=True),
}


def orientation_of_exif(value: object) -> Orientation:
    """The orientation that an Exif tag states (TIFF 6.0, tag 274); upright for unknown values."""
    return _BY_EXIF.get(value, UPRIGHT) if isinstance(value, int) else UPRIGHT


def orientation_of_matrix(content: bytes) -> Orientation:
    """The orientation that a display matrix states, of ISO/IEC 14496-12 as FFmpeg passes it on.

    The matrix takes (x, y) to (a x + c y, b x + d y) and is stored as a, b, u, c, d, v, x, y, w.
    Turns other than by quarters count as the nearest one.
    """
    if len(content) < _MATRIX_BYTES:
        return UPRIGHT
    a, b, _, c, d = struct.unpack_from("<5i", content)
    if abs(a) + abs(d) >= abs(b) + abs(c):
        return Orientation(reverses_columns=a < 0, reverses_rows=d < 0)
    return Orientation(is_transposed=True, reverses_columns=c < 0, reverses_rows=b < 0)
