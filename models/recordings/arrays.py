"""Arrays as pictures and recordings: NumPy (.npy, .npz) and MATLAB up to version 7 (.mat).

A file holds one array of pictures.  Only .npy is written; arrays of the other formats are loaded as
a whole.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError, FrameError
from ...factory.isolated import look_at
from .base import (
    ARRAY_SUFFIX,
    FULL_SCALE,
    FileOfFrames,
    Frame,
    Samples,
    ask_bytes,
    ask_pixels,
    explained,
    swapped,
)

SUFFIXES = (ARRAY_SUFFIX, ".npz", ".mat")
LEAST_SIDE_PX = 16
"""Smaller arrays are tables: poses, matrices, bearings."""
_COLOURS = (1, 3, 4)
_MATLAB_CLASSES = {"double": "f8", "single": "f4"} | {
    f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4)
}
"""Class -> dtype; the others (logical, char, cell, struct, sparse) are no pictures."""
_FORMAT: Any = np.lib.format  # whose functions are not typed

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Header:
    """An array of pictures.

    shape: (N, H, W) or (N, H, W, colours), red first.  dtype: as it is stored.
    single: whether the array is one picture, without an axis for their number.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    single: bool = False


def kind_of_arrays(path: Path) -> str | None:
    """`pictures` for a .npy file of one, `array` for others, None where none is of pictures.

    Of a file that cannot be read, as if it held some.
    """
    alone = path.suffix.lower() == ARRAY_SUFFIX
    try:
        found = _headers(path, path.stat().st_mtime_ns)
    except (FactoryError, OSError):
        return "pictures" if alone else "array"
    if not found:
        return None
    return "pictures" if alone and found["array"].single else "array"


def is_table(path: Path) -> bool:
    """Whether a file of arrays holds no pictures: folders have such beside them."""
    return path.suffix.lower() in SUFFIXES and kind_of_arrays(path) is None


class ArrayFile(FileOfFrames):
    """A `Recording` of the pictures in an array of a file, colours in BGR order.

    header: of that array.
    """

    def _open(self) -> None:
        self._array: Array | None = None
        self._matlab = self.path.suffix.lower() == ".mat"
        headers = _headers(self.path, self.path.stat().st_mtime_ns)
        if not headers:
            number = "(H, W, N) or (H, W, 3, N)" if self._matlab else "(N, H, W) or (N, H, W, 3)"
            raise FrameError(
                f"{self.path}: holds no pictures; expected (H, W), (H, W, 3) or, of several "
                f"pictures, {number}, {LEAST_SIDE_PX} pixels or more on a side"
            )
        if len(headers) > 1:
            raise FrameError(
                f"{self.path}: holds several arrays of pictures ({', '.join(list(headers)[:6])}); "
                "save the one that is meant as .npy"
            )
        ((self.name, self.header),) = headers.items()
        ask_pixels(str(self.path), self.header.shape[2], self.header.shape[1])
        if self.path.suffix.lower() != ARRAY_SUFFIX:
            count = int(np.prod(self.header.shape, dtype=object))
            ask_bytes(f"{self.path}: {self.name}", count * self.header.dtype.itemsize, self.size)

    def __len__(self) -> int:
        return self.header.shape[0]

    def _read(self, number: int) -> Frame:
        what = f"{self.path}" if self.header.single else f"{self.path}: picture {number + 1}"
        with explained(f"{what}: cannot be read; is the file damaged?", reason=True):
            if self._array is None:
                self._array = _load(self.path, self.name)
            page = self._array
            if not self.header.single:
                page = page[..., number] if self._matlab else page[number]
            page = np.ascontiguousarray(swapped(page))
        return Frame(number, as_samples(page, what))


class NpyWriter:
    """Writes an array of pictures as a .npy file, picture by picture; close it."""

    def __init__(self, path: Path, header: Header) -> None:
        """Raises OSError, as do the others."""
        self._dtype = header.dtype.newbyteorder("=")
        self._file = path.open("wb")
        shape = header.shape[1:] if header.single else header.shape
        said = {"descr": self._dtype.str, "fortran_order": False, "shape": shape}
        _FORMAT.write_array_header_1_0(self._file, said)

    def add(self, picture: Array) -> None:
        """The next picture, (H, W) or (H, W, colours) in BGR order."""
        self._file.write(np.ascontiguousarray(swapped(picture), self._dtype).tobytes())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


@lru_cache(maxsize=4096)
def _headers(path: Path, changed_ns: int) -> Mapping[str, Header]:
    """Name -> array of those that may be pictures.  Raises FrameError."""
    suffix = path.suffix.lower()
    with explained(f"{path}: not a readable file of arrays ({suffix})"):
        if suffix == ".mat":
            # SciPy may crash over a damaged file, so another process looks at it first.
            arrays = look_at(path, list_matlab, str(path))
        elif suffix == ".npz":
            arrays = list(_members(path))
        else:
            array = _load(path, "array")
            arrays = [("array", array.shape, array.dtype)]
        found = {
            name: header_of(tuple(shape), np.dtype(kind), matlab=suffix == ".mat")
            for name, shape, kind in arrays
        }
        return {name: header for name, header in found.items() if header is not None}


def _load(path: Path, name: str) -> Array:
    """An array of a file, mapped where that can be.  May raise nearly anything."""
    suffix = path.suffix.lower()
    if suffix == ".mat":
        import scipy.io

        # Where numbers are complex SciPy would leave out the imaginary part.
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        # With its class: whole numbers of class double are stored as smaller ones.
        return np.asarray(scipy.io.loadmat(path, mat_dtype=True, variable_names=[name])[name])
    if suffix == ".npz":
        with ZipFile(path) as archive, archive.open(name + ARRAY_SUFFIX) as stream:
            return np.asarray(_FORMAT.read_array(stream, allow_pickle=False))
    return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))


def header_of(
    shape: tuple[int, ...], dtype: np.dtype[Any], *, matlab: bool = False
) -> Header | None:
    """What an array holds by its shape; None where these cannot be pictures.

    matlab: the number of the picture is the last axis, (H, W, N) or (H, W, 3, N).
    """
    colours = (3,) if matlab else _COLOURS  # its four are rather four pictures
    single = len(shape) == 2 or (len(shape) == 3 and shape[2] in colours)
    if dtype.kind not in "uif" or 0 in shape or not 2 <= len(shape) <= 4:
        return None
    pages = (1, *shape) if single else (shape[-1], *shape[:-1]) if matlab else shape
    if len(pages) == 4 and pages[3] not in colours:
        return None
    return Header(pages, dtype, single) if min(pages[1:3]) >= LEAST_SIDE_PX else None


def _members(path: Path) -> Iterator[tuple[str, tuple[int, ...], np.dtype[Any]]]:
    """(name, shape, dtype) of the arrays in a .npz file."""
    with ZipFile(path) as archive:
        for name in archive.namelist():
            if name.endswith(ARRAY_SUFFIX):
                with archive.open(name) as stream:
                    first = _FORMAT.read_magic(stream) == (1, 0)
                    version = "1_0" if first else "2_0"
                    shape, _, dtype = getattr(_FORMAT, f"read_array_header_{version}")(stream)
                yield name.removesuffix(ARRAY_SUFFIX), shape, dtype


def list_matlab(path: str) -> list[list[Any]]:
    """[name, shape, dtype] of the numbers in a file.  May crash, see `look_at`."""
    import scipy.io

    return [
        [name, [int(one) for one in shape], _MATLAB_CLASSES[kind]]
        for name, shape, kind in scipy.io.whosmat(path)
        if kind in _MATLAB_CLASSES
    ]


def as_samples(page: Array, what: str) -> Samples:
    """A page whose numbers are grey values as they are: uint8, uint16, or floats as float32.

    what: names it in errors.  Raises FrameError for other dtypes, NaN and floats outside 0..1.
    """
    if page.dtype.kind == "f":
        with np.errstate(over="ignore"):  # infinite: outside 0..1
            page = page.astype(np.float32)
    if str(page.dtype) not in FULL_SCALE:
        raise FrameError(f"{what}: pixels are {page.dtype}; expected {', '.join(FULL_SCALE)}")
    if page.dtype == np.float32 and not (page.min() >= 0 and page.max() <= 1):
        raise FrameError(
            f"{what}: floats must be grey values from 0 to 1, these are {page.min():g} to "
            f"{page.max():g}; scale them (of echoes in linear units the logarithm)"
        )
    return page
