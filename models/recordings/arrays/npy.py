"""NumPy files of one array (.npy)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from .base import Arrays, Header, Page, header_of

NAME = "array"
"""The array's, which has none of its own."""


class Npy(Arrays):
    """See `Arrays`."""

    def __init__(self, path: Path) -> None:
        self._array: npt.NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
        found = header_of(self._array.shape, self._array.dtype)
        self.headers = {} if found is None else {NAME: found}
        self.held = f"an array {self._array.shape} of {self._array.dtype}"

    def page(self, name: str, number: int) -> Page:
        """See `Arrays`."""
        return self._array if self.headers[name].single else self._array[number]

    def rewriting(self, name: str, path: Path) -> Pages:
        """See `Arrays`."""
        return Pages(path.open("wb"), self.headers[name])

    def close(self) -> None:
        """Nothing but a map is held open."""


class Pages:
    """Writes an array of NumPy page by page, rows first; a `Rewriting`."""

    def __init__(self, file: BinaryIO, header: Header) -> None:
        self._file, self._dtype = file, header.dtype
        shape = header.shape[1:] if header.single else header.shape
        said = {"descr": header.dtype.str, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, said)  # type: ignore[no-untyped-call]

    def add(self, page: Page) -> None:
        """See `Rewriting`."""
        self._file.write(np.ascontiguousarray(page, self._dtype).tobytes())

    def close(self) -> None:
        """See `Rewriting`."""
        self._file.close()
