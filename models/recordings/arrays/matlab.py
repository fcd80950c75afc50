"""MATLAB's files (.mat): up to version 7 by SciPy, of version 7.3 they are HDF5."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ....factory.dataset.read.reader import look_at
from ....factory.errors import FrameError
from .base import (
    MATLAB_CLASSES,
    MOST_BYTES,
    Arrays,
    Header,
    Page,
    header_of,
)

_HDF5 = b"\x89HDF\r\n\x1a\n"


def open_matlab(path: Path) -> Arrays:
    """The arrays of a file of any version.  Raises FrameError where it takes SciPy, an extra."""
    with path.open("rb") as file:
        begins = file.read(520)
    if _HDF5 in (begins[:8], begins[512:]):
        from .hdf5 import Hdf5

        return Hdf5(path, matlab=True)
    return Matlab(path)


class Matlab(Arrays):
    """See `Arrays`; an array is read as a whole."""

    def __init__(self, path: Path) -> None:
        try:
            import scipy.io  # noqa: F401  an extra
        except ImportError as error:
            raise FrameError(
                f"{path}: reading MATLAB files needs scipy: pip install 'simnfnd[sonar]'"
            ) from error
        self._path = path
        self.headers = look_at(path, list_arrays, path)
        self._read: tuple[str, Page] | None = None

    def page(self, name: str, number: int) -> Page:
        """See `Arrays`."""
        header = self.headers[name]
        array = self._array(name)
        return array if header.single else array[..., number]

    def _array(self, name: str) -> Page:
        if self._read is None or self._read[0] != name:
            if self.headers[name].bytes > MOST_BYTES:
                raise MemoryError
            try:
                self._read = name, _loaded(self._path, variable_names=[name])[name]
            except np.exceptions.ComplexWarning as error:
                raise FrameError(
                    f"{self._path}: {name} holds complex numbers; save their magnitude, in decibels"
                ) from error
        return self._read[1]

    def rewriting(self, name: str, path: Path) -> _Rewriting:
        """See `Arrays`."""
        return _Rewriting(self._path, name, self._array(name).copy(), self.headers[name], path)

    def close(self) -> None:
        """Nothing is held open."""


class _Rewriting:
    """All variables again, with one of them new."""

    def __init__(self, source: Path, name: str, array: Page, header: Header, path: Path) -> None:
        self._source, self._name, self._path = source, name, path
        self._array, self._header, self._count = array, header, 0

    def add(self, page: Page) -> None:
        """See `Rewriting`."""
        self._array[() if self._header.single else (..., self._count)] = page
        self._count += 1

    def close(self) -> None:
        """See `Rewriting`."""
        import scipy.io

        if self._count < self._header.shape[0]:
            return  # broken off: nobody will see the file
        try:
            kept = dict(_variables(self._source)) | {self._name: self._array}
            scipy.io.savemat(self._path, kept, do_compression=True, long_field_names=True)
        except OSError:
            raise
        except Exception as error:
            raise FrameError(
                f"{self._source}: holds objects that cannot be written again; save "
                f"{self._name} alone in a file of its own"
            ) from error


def _variables(path: Path) -> Iterator[tuple[str, Any]]:
    """Each of a file's own variables, of the class that it has in MATLAB."""
    import scipy.io

    for name, _, _ in scipy.io.whosmat(path):
        try:
            yield name, _loaded(path, variable_names=[name])[name]
        except np.exceptions.ComplexWarning:
            yield name, scipy.io.loadmat(path, variable_names=[name])[name]


def _loaded(path: Path, **which: Any) -> dict[str, Any]:
    """Variables with their classes: whole numbers of class double are stored as smaller ones.

    Raises ComplexWarning for complex numbers, of which SciPy would leave out the imaginary part.
    """
    import scipy.io

    with warnings.catch_warnings():
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        found: dict[str, Any] = scipy.io.loadmat(path, mat_dtype=True, **which)
    return found


def list_arrays(path: Path) -> dict[str, Header]:
    """Name -> array of pictures, from the headers of a file up to version 7."""
    import scipy.io

    found = {}
    for name, shape, kind in scipy.io.whosmat(path):
        dtype = MATLAB_CLASSES.get(kind)
        header = dtype and header_of(tuple(map(int, shape)), np.dtype(dtype), matlab=True)
        if header:
            found[name] = header
    return found
