"""How stored pixels are to be turned before anybody looks at them.

Cameras and phones store pixels as their sensor gave them, and a tag beside them says which side is
up: the Exif orientation of an image, the display matrix of a video.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Array

EXIF_ORIENTATION = 274
"""Number of the Exif (and TIFF) tag."""


class Orientation(NamedTuple):
    """What turns stored pixels upright: transpose first, then reverse columns and rows."""

    is_transposed: bool = False
    reverses_columns: bool = False
    reverses_rows: bool = False

    def upright(self, pixels: Array) -> Array:
        """(H, W) or (H, W, C) as people should see it; a copy in one piece where it turns."""
        if not any(self):
            return pixels
        if self.is_transposed:
            pixels = pixels.swapaxes(0, 1)
        columns = -1 if self.reverses_columns else 1
        rows = -1 if self.reverses_rows else 1
        return np.ascontiguousarray(pixels[::rows, ::columns])


UPRIGHT = Orientation()


def orientation_of_exif(value: object) -> Orientation:
    """The orientation that an Exif tag states (TIFF 6.0, tag 274); upright for unknown values."""
    return Orientation(
        is_transposed=value in (5, 6, 7, 8),
        reverses_columns=value in (2, 3, 6, 7),
        reverses_rows=value in (3, 4, 7, 8),
    )


def orientation_of_matrix(content: bytes) -> Orientation:
    """The orientation that a display matrix states, of ISO/IEC 14496-12 as FFmpeg passes it on.

    The matrix takes (x, y) to (a x + c y, b x + d y) and is stored as a, b, u, c, d, v, x, y, w,
    in 32 bits each.  Turns other than by quarters count as the nearest one.
    """
    if len(content) < 36:
        return UPRIGHT
    a, b, _, c, d = struct.unpack_from("<5i", content)
    if abs(a) + abs(d) >= abs(b) + abs(c):
        return Orientation(reverses_columns=a < 0, reverses_rows=d < 0)
    return Orientation(is_transposed=True, reverses_columns=c < 0, reverses_rows=b < 0)
