"""The pictures of one layer of a shard, each compared with its checksum."""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ..format.checksums import DEFLATE, crc32, picture_sums

Image = npt.NDArray[Any]


class ImageStack:
    """`stack[row]` is one (H, W) picture, as stored and writable.

    Pictures in colour have a third dimension.
    sums: (samples,) `crc32` of each picture, where they were read already.
    Raises FactoryError (without the file's name) for a picture that is damaged.
    """

    def __init__(self, dataset: h5py.Dataset, sums: npt.NDArray[np.uint32] | None = None) -> None:
        self._dataset = dataset
        self._gzip = dataset.compression == "gzip"
        self._form: tuple[tuple[int, ...], Any] = dataset.shape[1:], dataset.dtype
        self._sums = picture_sums(dataset.file)[dataset.name[1:]] if sums is None else sums

    def __len__(self) -> int:
        """Number of pictures."""
        return len(self._dataset)

    def __getitem__(self, row: int) -> Image:
        """One picture."""
        number = range(len(self))[row]
        image: Image = np.empty(*self._form)
        try:
            if self._gzip:
                pixels = self._unpacked(number, image.nbytes)
                image.reshape(-1).view(np.uint8)[:] = np.frombuffer(pixels, np.uint8)
            else:
                self._dataset.read_direct(image, np.s_[number])
            if crc32(image) != self._sums[number]:
                raise ValueError("its checksum differs")
        except (MemoryError, OSError, RuntimeError, ValueError, DEFLATE.error) as error:
            reason = " ".join(str(error).split())[:120] or "not in the table of chunks"
            raise FactoryError(
                f"{self._dataset.name} sample {number} is damaged ({reason}); delete the file and "
                "run the command that made the dataset again"
            ) from error
        return image

    def _unpacked(self, number: int, size: int) -> bytes:
        """The bytes of a gzip chunk: 1.5 times as fast as by HDF5, and never more than `size`."""
        _, packed = self._dataset.id.read_direct_chunk((number, *(0 for _ in self._form[0])))
        pixels: bytes = DEFLATE.decompressobj().decompress(packed, size)
        if len(pixels) != size:
            raise ValueError(f"it does not hold the {size} bytes of a picture")
        return pixels
