"""Pictures of shards, each compared with its checksum; open files are kept for the next read."""

from __future__ import annotations

import os
import threading
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ..format.checksums import DEFLATE, crc32, picture_sums
from .reader import open_shard

Image = npt.NDArray[Any]

# A process may have 1024 files open as a rule, and a loader may read several datasets.
_MOST_FILES = 64


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


class OpenShards:
    """Reads images; opens each shard when it is needed, and closes the least recent one.

    Safe under threads, fork, spawn and pickling.
    """

    def __init__(self) -> None:
        self._forget()

    def read(self, path: Path, layers: tuple[str, ...], row: int) -> list[Image]:
        """The layers of one sample, each (H, W), as stored.

        Raises FactoryError when the shard cannot be opened or a chunk is damaged.
        """
        if self._process != os.getpid():
            # After a fork: HDF5's state and a lock that another thread holds stay behind.
            self._forget()
        with self._lock:
            stacks = self._open.pop(path, None) or self._opened(path)
            self._open[path] = stacks
            try:
                return [stacks[name][row] for name in layers]
            except KeyError as error:
                absent = next(name for name in layers if name not in stacks.file)
                raise FactoryError(
                    f"{path}: has no layer {absent}; make the dataset with it in dataset.layers"
                ) from error
            except (FactoryError, IndexError) as error:
                raise FactoryError(f"{path}: {error}") from error

    def close(self) -> None:
        """Close every file; the next read opens what it needs."""
        if self._process != os.getpid():
            self._forget()
        with self._lock:
            while self._open:
                self._close_oldest()

    def _opened(self, path: Path) -> _Stacks:
        while len(self._open) >= _MOST_FILES:
            self._close_oldest()
        return _Stacks(open_shard(path))

    def _close_oldest(self) -> None:
        self._open.pop(next(iter(self._open))).file.close()

    def _forget(self) -> None:
        self._open: dict[Path, _Stacks] = {}
        self._lock = threading.Lock()
        self._process = os.getpid()

    def __reduce__(self) -> tuple[type[OpenShards], tuple[()]]:
        return OpenShards, ()


class _Stacks(dict[str, ImageStack]):
    """The layers of one file by name; looking one up in HDF5 costs as much as a small read."""

    def __init__(self, file: h5py.File) -> None:
        super().__init__()
        self.file = file
        self._sums = picture_sums(file)

    def __missing__(self, name: str) -> ImageStack:
        stack = self.file[name]
        self[name] = ImageStack(stack, self._sums[name])
        return self[name]
