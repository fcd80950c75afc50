"""Open shard files, kept for the next read: safe under threads, fork, spawn and pickling."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import h5py

from ...errors import FactoryError
from ..format.checksums import picture_sums
from .image_stack import Image, ImageStack
from .reader import open_shard

# A process may have 1024 files open as a rule, and a loader may read several datasets.
_MOST_FILES = 64


class OpenShards:
    """Reads images; opens each shard when it is needed, and closes the least recent one."""

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
