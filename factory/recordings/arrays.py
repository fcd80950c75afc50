"""NumPy files (.npy): a picture, or pictures one after the other."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from simnfnd.factory.errors import FrameError
from simnfnd.factory.recordings.base import (
    ARRAY_SUFFIX,
    FULL_SCALE,
    MOST_PIXELS,
    FileOfFrames,
    Frame,
    Samples,
)

LEAST_SIDE_PX = 16
"""Smaller arrays are tables: poses, matrices, bearings."""
_COLOURS = (1, 3, 4)
_KINDS = "(H, W), (H, W, 3) or, of several pictures, (N, H, W) or (N, H, W, 3)"


Kind = Literal["picture", "several", "other"]


def kind_of_array(path: Path) -> Kind:
    """What the header of a .npy file says it holds; `picture` where it cannot be read.

    other: a shape that no pictures have, or values that are no numbers.
    """
    try:
        return _kind(_mapped(path))
    except FrameError:
        return "picture"  # reading says what is wrong


def _kind(array: npt.NDArray[Any]) -> Kind:
    sides = _sides(array.shape)
    if sides is None or min(sides) < LEAST_SIDE_PX or array.dtype.kind not in "uif":
        return "other"
    return "picture" if sides == array.shape[:2] else "several"


def is_table(path: Path) -> bool:
    """Whether a file is an array that holds no pictures: folders have such beside them."""
    return path.suffix.lower() == ARRAY_SUFFIX and kind_of_array(path) == "other"


def read_array(path: Path) -> Samples:
    """The picture of a .npy file, of several the first, (H, W) or (H, W, colours) in BGR order.

    Raises FrameError; floats of any size become float32.
    """
    array = _checked(path)
    return _page(array if _kind(array) == "picture" else array[0], str(path))


class ArrayFile(FileOfFrames):
    """A `Recording` of the pictures in an array (N, H, W) or (N, H, W, colours)."""

    def _open(self) -> None:
        array = _checked(self.path)
        self._array = array if _kind(array) == "several" else array[np.newaxis]

    def __len__(self) -> int:
        return len(self._array)

    def _read(self, number: int) -> Frame:
        return Frame(number, _page(self._array[number], f"{self.path}: picture {number + 1}"))


def array_bytes(picture: npt.NDArray[Any]) -> bytes:
    """A .npy file of a picture, whose colours become RGB."""
    buffer = BytesIO()
    np.save(buffer, swapped(picture), allow_pickle=False)
    return buffer.getvalue()


class ArrayWriter:
    """Takes pictures in order and writes them as one array (N, ...); close it."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("wb")
        self._first: Samples | None = None
        self._count = 0

    def add(self, picture: Samples) -> None:
        """The next picture, (H, W) or (H, W, colours) in BGR order, all of one shape and dtype."""
        if self._first is None:
            self._first = picture
            self._write_header()
        self._file.write(np.ascontiguousarray(swapped(picture)).tobytes())
        self._count += 1

    def close(self) -> None:
        """Write how many there are, and close the file."""
        self._file.seek(0)
        if self._first is not None:
            self._write_header()
        self._file.close()

    def _write_header(self) -> None:
        # NumPy leaves room in the header for an array that grows.
        assert self._first is not None
        shape = (self._count, *self._first.shape)
        header = {"descr": self._first.dtype.str, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._file, header)  # type: ignore[no-untyped-call]


def swapped(picture: npt.NDArray[Any]) -> Samples:
    """Colours in OpenCV's order (BGR), or the other way round; numbers as the machine orders them.

    picture: (H, W) or (H, W, C); what is beside three colours stays where it is.
    """
    if picture.ndim == 3 and picture.shape[2] >= 3:
        picture = np.concatenate([picture[..., 2::-1], picture[..., 3:]], axis=2)
    return picture.astype(picture.dtype.newbyteorder("="), copy=False)


def _sides(shape: tuple[int, ...]) -> tuple[int, int] | None:
    """Height and width of the pictures in an array; None where these cannot be."""
    if len(shape) == 2:
        return shape[0], shape[1]
    if len(shape) == 3:
        return (shape[0], shape[1]) if shape[2] in _COLOURS else (shape[1], shape[2])
    return (shape[1], shape[2]) if len(shape) == 4 and shape[3] in _COLOURS else None


def _mapped(path: Path) -> npt.NDArray[Any]:
    try:
        array: npt.NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    except OSError as error:
        raise FrameError(f"{path}: cannot be read ({error.strerror or 'no array'})") from error
    except Exception as error:  # a damaged header makes NumPy raise nearly anything
        raise FrameError(f"{path}: not a readable NumPy array (.npy)") from error
    return array


def _checked(path: Path) -> npt.NDArray[Any]:
    """The array of a file, not read yet.  Raises FrameError unless it holds pictures."""
    array = _mapped(path)
    if _kind(array) == "other" or array.size == 0:
        raise FrameError(
            f"{path}: an array {array.shape} of {array.dtype} holds no pictures; expected "
            f"{_KINDS}, {LEAST_SIDE_PX} pixels or more on a side"
        )
    height, width = _sides(array.shape) or (0, 0)
    if height * width > MOST_PIXELS:
        raise FrameError(f"{path}: {width} x {height} pixels are more than can be read")
    return array


def _page(page: npt.NDArray[Any], what: str) -> Samples:
    if page.dtype.kind == "f":
        with np.errstate(over="ignore"):  # infinite: outside 0..1
            page = page.astype(np.float32)
    page = np.ascontiguousarray(swapped(page))
    if str(page.dtype) not in FULL_SCALE:
        raise FrameError(f"{what}: pixels are {page.dtype}; expected {', '.join(FULL_SCALE)}")
    if page.dtype == np.float32 and np.isnan(page).any():
        raise FrameError(f"{what}: holds NaN; set what was not measured to 0")
    if page.dtype == np.float32 and not (page.min() >= 0 and page.max() <= 1):
        raise FrameError(
            f"{what}: floats must be grey values from 0 to 1, these are {page.min():g} to "
            f"{page.max():g}; scale them (echoes in linear units: their logarithm)"
        )
    return page
