"""Arrays as pictures and recordings: NumPy (.npy, .npz) and MATLAB up to version 7 (.mat).

A file holds one array of pictures.  Only .npy is written; arrays of the other formats are loaded as
a whole.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal
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
_NAMED = 6
"""How many arrays an error names."""
_FORMAT: Any = np.lib.format  # whose functions are not typed

Array = npt.NDArray[Any]
Kind = Literal["picture", "several", "other"]


@dataclass(frozen=True)
class Header:
    """An array of pictures.

    shape: (N, H, W) or (N, H, W, colours), red first.  dtype: as it is stored.
    single: whether the array is one picture, without an axis for their number.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    single: bool = False

    @property
    def bytes(self) -> int:
        """Of the whole array."""
        return int(np.prod(self.shape, dtype=object)) * self.dtype.itemsize

    def __str__(self) -> str:
        shape = self.shape[1:] if self.single else self.shape
        return f"({', '.join(map(str, shape))}) {self.dtype}"


def kind_of_arrays(path: Path) -> Kind:
    """What a file with one of `SUFFIXES` holds; of one that cannot be read, pictures.

    picture: one, in a .npy file.  other: no arrays of pictures.
    """
    alone = path.suffix.lower() == ARRAY_SUFFIX
    try:
        found = _headers(path, path.stat().st_mtime_ns)
    except (FactoryError, OSError):
        return "picture" if alone else "several"
    if not found:
        return "other"
    return "picture" if alone and all(one.single for one in found.values()) else "several"


def is_table(path: Path) -> bool:
    """Whether a file of arrays holds no pictures: folders have such beside them."""
    return path.suffix.lower() in SUFFIXES and kind_of_arrays(path) == "other"


def read_array(path: Path) -> Samples:
    """The picture of a .npy file, of several the first, (H, W) or (H, W, colours) in BGR order.

    Raises FrameError; floats of any size become float32.
    """
    try:
        with ArrayFile(path) as file:
            return file[0].samples
    except FrameError:
        raise
    except FactoryError as error:
        raise FrameError(str(error)) from error


class ArrayFile(FileOfFrames):
    """A `Recording` of the pictures in an array of a file.

    header: of that array.
    """

    def __init__(self, path: Path) -> None:
        """Raises FactoryError when it holds no pictures, or several arrays of them."""
        self._array: Array | None = None
        super().__init__(path)

    def _open(self) -> None:
        headers = _headers(self.path, self.path.stat().st_mtime_ns)
        if not headers:
            number = "(H, W, N) or (H, W, 3, N)" if self._matlab else "(N, H, W) or (N, H, W, 3)"
            raise FrameError(
                f"{self.path}: holds no pictures; expected (H, W), (H, W, 3) or, of several "
                f"pictures, {number}, {LEAST_SIDE_PX} pixels or more on a side"
            )
        if len(headers) > 1:
            raise FrameError(
                f"{self.path}: holds several arrays of pictures: {_named(headers)}; save the one "
                "that is meant as .npy"
            )
        (self.name,) = headers
        self.header = headers[self.name]
        ask_pixels(str(self.path), self.header.shape[2], self.header.shape[1])
        if self.path.suffix.lower() != ARRAY_SUFFIX:
            ask_bytes(f"{self.path}: {self.name}", self.header.bytes, self.size)

    @property
    def _matlab(self) -> bool:
        return self.path.suffix.lower() == ".mat"

    def __len__(self) -> int:
        return self.header.shape[0]

    def _page(self, number: int) -> Array:
        """A picture as it is stored, colours in BGR order.  Raises FrameError."""
        with explained(f"{self.path}: picture {number + 1} cannot be read; is the file damaged?"):
            if self._array is None:
                self._array = _load(self.path, self.name)
            array = self._array
            if not self.header.single:
                array = array[..., number] if self._matlab else array[number]
            return np.ascontiguousarray(swapped(array))

    def _read(self, number: int) -> Frame:
        what = f"{self.path}: picture {number + 1}"
        if self.header.single:
            what = str(self.path)
        return Frame(number, as_samples(self._page(number), what))


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
            return _matlab_headers(path)
        if suffix == ".npz":
            with ZipFile(path) as archive:
                return _npz_headers(archive)
        return _found({"array": _load(path, "array")})


def _load(path: Path, name: str) -> Array:
    """An array of a file, mapped where that can be.  May raise nearly anything."""
    suffix = path.suffix.lower()
    if suffix == ".mat":
        return _load_matlab(path, name)
    if suffix == ".npz":
        with ZipFile(path) as archive, archive.open(name + ARRAY_SUFFIX) as stream:
            return np.asarray(_FORMAT.read_array(stream, allow_pickle=False))
    return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))


def _found(arrays: Mapping[str, Any]) -> dict[str, Header]:
    headers = {name: header_of(one.shape, one.dtype) for name, one in arrays.items()}
    return {name: one for name, one in headers.items() if one is not None}


def header_of(
    shape: tuple[int, ...], dtype: np.dtype[Any], *, matlab: bool = False
) -> Header | None:
    """What an array holds by its shape; None where these cannot be pictures.

    matlab: the number of the picture is the last axis, (H, W, N) or (H, W, 3, N).
    """
    colours = (3,) if matlab else _COLOURS  # its four are rather four pictures
    if dtype.kind not in "uif" or 0 in shape:
        return None
    single = len(shape) == 2 or (len(shape) == 3 and shape[2] in colours)
    if single:
        pages = (1, *shape)
    elif len(shape) in (3, 4):
        pages = (shape[-1], *shape[:-1]) if matlab else shape
    else:
        return None
    if len(pages) == 4 and pages[3] not in colours:
        return None
    return Header(pages, dtype, single) if min(pages[1:3]) >= LEAST_SIDE_PX else None


def _npz_headers(archive: ZipFile) -> dict[str, Header]:
    read = {(1, 0): _FORMAT.read_array_header_1_0, (2, 0): _FORMAT.read_array_header_2_0}
    found = {}
    for info in archive.infolist():
        if not info.filename.endswith(ARRAY_SUFFIX):
            continue
        with archive.open(info) as stream:
            version = _FORMAT.read_magic(stream)
            if version in read:  # newer ones are of tables
                shape, _, dtype = read[version](stream)
                header = header_of(shape, dtype)
                if header is not None:
                    found[info.filename.removesuffix(ARRAY_SUFFIX)] = header
    return found


def _matlab_headers(path: Path) -> dict[str, Header]:
    try:
        import scipy.io  # noqa: F401  an extra
    except ImportError as error:
        raise FrameError(
            f"{path}: reading MATLAB files needs scipy: pip install 'simnfnd[sonar]'"
        ) from error
    found = {}
    # SciPy may crash over a damaged file, so another process looks at it first.
    for name, shape, kind in look_at(path, list_matlab, str(path)):
        header = header_of(tuple(shape), np.dtype(kind), matlab=True)
        if header is not None:
            found[name] = header
    return found


def list_matlab(path: str) -> list[list[Any]]:
    """[name, shape, dtype] of the numbers in a file.  May crash, see `look_at`."""
    import scipy.io

    return [
        [name, [int(one) for one in shape], _MATLAB_CLASSES[kind]]
        for name, shape, kind in scipy.io.whosmat(path)
        if kind in _MATLAB_CLASSES
    ]


def _load_matlab(path: Path, name: str) -> Array:
    """With its class: whole numbers of class double are stored as smaller ones."""
    import scipy.io

    with warnings.catch_warnings():
        # SciPy would leave out the imaginary part.
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        try:
            found = scipy.io.loadmat(path, mat_dtype=True, variable_names=[name])[name]
        except np.exceptions.ComplexWarning as error:
            raise FrameError(
                f"{path}: {name} holds complex numbers; save their magnitude, in decibels"
            ) from error
    return np.asarray(found)


def as_samples(page: Array, what: str) -> Samples:
    """A page whose numbers are grey values as they are: uint8, uint16, or floats as float32.

    what: names it in errors.  Raises FrameError for other dtypes, NaN and floats outside 0..1.
    """
    if page.dtype.kind == "f":
        with np.errstate(over="ignore"):  # infinite: outside 0..1
            page = page.astype(np.float32)
    if str(page.dtype) not in FULL_SCALE:
        raise FrameError(f"{what}: pixels are {page.dtype}; expected {', '.join(FULL_SCALE)}")
    if page.dtype == np.float32 and np.isnan(page).any():
        raise FrameError(f"{what}: holds NaN; set what was not measured to 0")
    if page.dtype == np.float32 and not (page.min() >= 0 and page.max() <= 1):
        raise FrameError(
            f"{what}: floats must be grey values from 0 to 1, these are {page.min():g} to "
            f"{page.max():g}; scale them (of echoes in linear units the logarithm)"
        )
    return page


def _named(headers: Mapping[str, Header]) -> str:
    shown = [f"{name} {header}" for name, header in list(headers.items())[:_NAMED]]
    more = f" and {len(headers) - _NAMED} more" if len(headers) > _NAMED else ""
    return ", ".join(shown) + more
