"""The pictures of one layer of a shard, decoded here and not in HDF5.

HDF5 does not look at how much comes out of a chunk: of one that is too short it shows whatever its
memory held before, and one that was made to grow takes gigabytes.  It also shows zeros for a chunk
that its table cannot find.  Chunks are therefore read as they are stored, decoded to the size of a
picture and no further, and compared with the picture's checksum.
"""

from __future__ import annotations

import sys
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ..format.checksums import DEFLATE, crc32, picture_sums
from ..format.layout import chain_of

Image = npt.NDArray[Any]

# LZF: three bytes stand for 264 at most; h5py's filter takes all memory that it needs.
_LZF_GROWTH = 88
_LITTLE_BYTES = 1 << 27


class ImageStack:
    """`stack[row]` is one (H, W) picture, as stored and writable.

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

    def __getitem__(self, row: int) -> Image:
        """One picture."""
        number = range(len(self))[row]
        image: Image = np.empty(self._shape, self._dtype)
        origin = (number, *(0 for _ in self._shape))
        try:
            mask, content = self._dataset.id.read_direct_chunk(origin)
        except MemoryError as error:
            raise ValueError("not in the table of chunks") from error
        if problem := self._chain.problem(mask, len(content), self._bytes):
            raise ValueError(problem)
        codec, packed = self._chain.codec, content[: len(content) - self._chain.ending]
        if codec == "lzf" and not mask:
            too_large = len(packed) * _LZF_GROWTH > _LITTLE_BYTES
            if too_large and lzf_length(packed, self._bytes) != self._bytes:
                raise ValueError(f"it does not hold the {self._bytes} bytes of a picture")
            self._dataset.read_direct(image, np.s_[number])
        else:
            pixels = packed if mask or codec == "none" else self._unpacked(codec, packed)
            image.reshape(-1).view(np.uint8)[:] = np.frombuffer(pixels, np.uint8)
        if crc32(image) != self._sums[number]:
            raise ValueError("its checksum differs")
        return image

    def _unpacked(self, codec: str, packed: bytes) -> bytes:
        """The bytes of a picture, and never more, of a gzip or zstd chunk."""
        unpacker: Any
        failure: type[Exception]
        if codec == "gzip":
            unpacker, failure = DEFLATE.decompressobj(), DEFLATE.error
        else:
            if sys.version_info >= (3, 14):
                from compression import zstd
            else:
                from backports import zstd
            unpacker, failure = zstd.ZstdDecompressor(), zstd.ZstdError
        try:
            # One byte more, so that a longer stream shows and the stream's own checksum is read.
            pixels: bytes = unpacker.decompress(packed, self._bytes + 1)
        except failure as error:
            raise ValueError(str(error)) from error
        if len(pixels) != self._bytes or not unpacker.eof or unpacker.unused_data:
            raise ValueError(f"it does not hold the {self._bytes} bytes of a picture")
        return pixels


def lzf_length(content: bytes, most: int) -> int:
    """Bytes that LZF data stand for; stops beyond `most`.  Raises ValueError when they end early.

    A control byte c below 32 is followed by c + 1 bytes to copy.  Any other repeats c // 32 + 2
    bytes from before, or with c // 32 = 7 as many more as the next byte says; a byte of the offset
    follows (liblzf, lzf_d.c).
    """
    at = length = 0
    end = len(content)
    while at < end and length <= most:
        control = content[at]
        if control < 32:
            at += control + 2
            length += control + 1
            continue
        if control >= 224:
            at += 1
            if at >= end:
                break
            length += content[at]
        length += (control >> 5) + 2
        at += 2
    if at > end and length <= most:
        raise ValueError("its LZF data end early")
    return length
