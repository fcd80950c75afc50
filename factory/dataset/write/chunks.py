"""The bytes of a gzip chunk with its checksum, made without HDF5.

Its own deflate costs as much as forming the picture.  ISA-L makes the same format, as small, seven
times faster; HDF5 only stores what comes of it, and every reader opens it as any gzip chunk.
"""

from __future__ import annotations

import struct
import zlib

import h5py
import numpy as np
import numpy.typing as npt
from isal import isal_zlib

from ..format.filters import fletcher32

# What isal calls levels are others than zlib's, but these two are alike in size.
_ISAL_LEVEL = 1


def write_gzip_chunk(
    stack: h5py.Dataset, number: int, image: npt.NDArray[np.generic], level: int
) -> None:
    """Store an image as chunk `number` of a stack that has gzip and fletcher32 as its filters.

    image: of the stack's dtype and the shape of one chunk.  level: of gzip, 0 to 9.
    """
    content = deflate(np.ascontiguousarray(image), level)
    offset = (number, *(0 for _ in image.shape))
    stack.id.write_direct_chunk(offset, content + struct.pack("<I", fletcher32(content)))


def deflate(image: npt.NDArray[np.generic], level: int) -> bytes:
    """The zlib stream of an image's bytes: the same on every processor since SSE4.2 (2008)."""
    if level == _ISAL_LEVEL:
        return isal_zlib.compress(image.data, level)
    return zlib.compress(image.data, level)
