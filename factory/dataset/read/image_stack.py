"""The pictures of one layer of a shard, decoded here and not in HDF5.

HDF5 does not look at how much comes out of a chunk: of one that is too short it shows whatever its
memory held before, and one that was made to grow takes gigabytes.  It also shows zeros for a chunk
that its table cannot find.  Chunks are therefore read as they are stored, and decoded here to the
size of a picture and no further.
"""

from __future__ import annotations

import struct
import sys
import zlib
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ..format.checksums import crc32, picture_sums
from ..format.filters import chain_of, fletcher32
from .lzf import LZF_GROWTH, lzf_length

Image = npt.NDArray[Any]

_LITTLE_BYTES = 1 << 27


class ImageStack:
    """`stack[row]` is one (H, W) picture, `stack[a:b]` are (N, H, W), as stored and writable.

    Pictures in colour have a third dimension.
    sums: (samples,) `crc32` of each picture, where they were read already.
    Raises OSError, RuntimeError or ValueError for a picture that is damaged or cannot be found.
    """

    def __init__(self, dataset: h5py.Dataset, sums: npt.NDArray[np.uint32] | None = None) -> None:
        self._dataset = dataset
        self._shape: tuple[int, ...] = dataset.shape[1:]
        self._dtype = dataset.dtype
        self._bytes = int(np.prod(self._shape)) * self._dtype.itemsize
        self._chain = chain_of(dataset)
        self._sums = picture_sums(dataset) if sums is None else sums

    def __len__(self) -> int:
        """Number of pictures."""
        return len(self._dataset)

    def __getitem__(self, rows: int | slice) -> Image:
        """One picture, or several that follow one another."""
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
        """Fill a contiguous array with one picture."""
        target = image.reshape(-1).view(np.uint8)
        codec, ending = self._chain.codec, self._chain.ending
        plain = codec == "none" and not ending
        try:
            # With a buffer that is too small h5py raises ValueError.
            mask, content = self._dataset.id.read_direct_chunk(
                (number, *(0 for _ in self._shape)), out=target if plain else None
            )
        except MemoryError as error:
            raise ValueError("not in the table of chunks") from error
        if not self._chain.may_be(mask, len(content), self._bytes):
            if mask:
                raise ValueError("a filter was left out")
            raise ValueError(f"its chunk is of {len(content)} bytes, its pixels of {self._bytes}")
        if ending and self._sums is None and codec != "gzip":
            self._check_ending(content)
        if mask or codec == "none":
            if not plain:
                target[:] = np.frombuffer(content, np.uint8, self._bytes)
        elif codec == "lzf":
            self._check_lzf(content[: len(content) - ending])
            self._dataset.read_direct(image, np.s_[number])
        else:
            unpack = self._inflated if codec == "gzip" else self._unzstd
            target[:] = np.frombuffer(unpack(content), np.uint8)
        if self._sums is not None and crc32(image) != self._sums[number]:
            raise ValueError("its checksum differs")

    def _check_ending(self, content: bytes) -> None:
        (wanted,) = struct.unpack("<I", content[-4:])
        if fletcher32(content[:-4]) != wanted:
            raise ValueError("its checksum differs")

    def _check_lzf(self, content: bytes) -> None:
        # To look costs more than to unpack; a picture with a checksum needs it for memory alone.
        small = len(content) * LZF_GROWTH <= _LITTLE_BYTES
        if (self._sums is None or not small) and (lzf_length(content, self._bytes) != self._bytes):
            raise self._other_size()

    def _other_size(self) -> ValueError:
        return ValueError(f"it does not hold the {self._bytes} bytes of a picture")

    def _inflated(self, content: bytes) -> bytes:
        codec = _deflate()
        unpacker = codec.decompressobj()
        try:
            # One byte more, so that a longer stream shows and the stream's own checksum is read.
            pixels: bytes = unpacker.decompress(content, self._bytes + 1)
        except codec.error as error:
            raise ValueError(str(error)) from error
        return self._whole(pixels, unpacker)

    def _unzstd(self, content: bytes) -> bytes:
        zstd = _zstd()
        unpacker = zstd.ZstdDecompressor()
        try:
            pixels: bytes = unpacker.decompress(content, self._bytes + 1)
        except zstd.ZstdError as error:
            raise ValueError(str(error)) from error
        return self._whole(pixels, unpacker)

    def _whole(self, pixels: bytes, unpacker: Any) -> bytes:
        if len(pixels) != self._bytes or not unpacker.eof:
            raise self._other_size()
        if len(unpacker.unused_data) != self._chain.ending:
            raise ValueError("its chunk is of a wrong length")
        return pixels


def _deflate() -> Any:
    try:
        from isal import isal_zlib  # two thirds of zlib's time
    except ImportError:
        return zlib
    return isal_zlib


def _zstd() -> Any:
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd
