"""The pictures of one layer of a shard, decoded here where that is safer and faster than in HDF5.

HDF5 does not look at how much comes out of a chunk: of one that is too short it shows whatever its
memory held before.  It also shows zeros for a chunk that its table cannot find.  Plain and gzip
chunks are therefore read as they are stored, and inflated here (by ISA-L where it is installed).
"""

from __future__ import annotations

import zlib
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[Any]

_CHECKSUM_BYTES = 4


class ImageStack:
    """`stack[row]` is one (H, W) picture, `stack[a:b]` are (N, H, W), as stored and writable.

    Raises OSError, RuntimeError or ValueError for a picture that is damaged or cannot be found.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._dataset = dataset
        self._shape: tuple[int, int] = dataset.shape[1:]
        self._dtype = dataset.dtype
        self._bytes = int(np.prod(self._shape)) * self._dtype.itemsize
        plist = dataset.id.get_create_plist()
        filters = [plist.get_filter(index)[0] for index in range(plist.get_nfilters())]
        deflate, fletcher32 = h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32
        self._plain = not filters
        self._deflated = filters in ([deflate], [deflate, fletcher32])
        self._after = _CHECKSUM_BYTES if fletcher32 in filters else 0

    def __len__(self) -> int:
        """Number of pictures."""
        return len(self._dataset)

    def __getitem__(self, rows: int | slice) -> Image:
        """One picture, or several that follow one another."""
        if not (self._plain or self._deflated):
            found: Image = self._dataset[rows]
            return found
        if not isinstance(rows, slice):
            image: Image = np.empty(self._shape, self._dtype)
            self._read(range(len(self))[rows], image)
            return image
        numbers = range(len(self))[rows]
        images: Image = np.empty((len(numbers), *self._shape), self._dtype)
        for image, number in zip(images, numbers, strict=True):
            self._read(number, image)
        return images

    def _read(self, number: int, image: Image) -> None:
        """Fill a contiguous (H, W) array with one picture."""
        target = image.reshape(-1).view(np.uint8)
        try:
            # With a buffer that is too small h5py raises ValueError.
            mask, content = self._dataset.id.read_direct_chunk(
                (number, 0, 0), out=target if self._plain else None
            )
        except MemoryError as error:
            raise ValueError("not in the table of chunks") from error
        if mask:
            raise ValueError("a filter was left out")
        if self._deflated:
            target[:] = np.frombuffer(self._inflated(content), np.uint8)
        elif len(content) != self._bytes:
            raise ValueError(f"{len(content)} of {self._bytes} bytes")

    def _inflated(self, content: bytes) -> bytes:
        codec = _codec()
        unpacker = codec.decompressobj()
        try:
            # One byte more, so that a longer stream shows and the stream's own checksum is read.
            pixels: bytes = unpacker.decompress(content, self._bytes + 1)
        except codec.error as error:
            raise ValueError(str(error)) from error
        if len(pixels) != self._bytes or not unpacker.eof:
            raise ValueError(f"it does not hold the {self._bytes} bytes of a picture")
        if len(unpacker.unused_data) != self._after:
            raise ValueError("its chunk is of a wrong length")
        return pixels


def _codec() -> Any:
    try:
        from isal import isal_zlib  # two thirds of zlib's time
    except ImportError:
        return zlib
    return isal_zlib
