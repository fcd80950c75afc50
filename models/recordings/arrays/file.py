"""An array of pictures in a file as a recording, and a copy of the file with other pictures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from ....factory.errors import FactoryError, FrameError
from ..base import ARRAY_SUFFIX, MOST_PIXELS, FileOfFrames, Frame, Samples
from . import FORMATS, HDF5_SUFFIXES, split_name
from .base import LEAST_SIDE_PX, Arrays, Header, Rewriting
from .levels import Levels, as_samples, swapped

_KINDS = "(H, W), (H, W, 3) or, of several pictures, (N, H, W) or (N, H, W, 3)"
_MATLAB = "(H, W), (H, W, 3) or, of several pictures, (H, W, N) or (H, W, 3, N)"
_NAMED = 6
"""How many arrays an error names."""


Kind = Literal["picture", "several", "other"]


def kind_of_arrays(path: Path) -> Kind:
    """What a file with a suffix of `FORMATS` holds; of one that cannot be read, pictures.

    picture: one, in a .npy file.  other: no arrays of pictures; of HDF5 files, also what is damaged
    or a shard, for which there is another reader.
    """
    suffix = path.suffix.lower()
    try:
        found = _headers(path, path.stat().st_mtime_ns)
    except (FactoryError, OSError):
        if suffix in HDF5_SUFFIXES:
            return "other"
        return "picture" if suffix == ARRAY_SUFFIX else "several"
    if not found:
        return "other"
    alone = suffix == ARRAY_SUFFIX and all(one.single for one in found.values())
    return "picture" if alone else "several"


@lru_cache(maxsize=4096)
def _headers(path: Path, changed_ns: int) -> dict[str, Header]:
    with _opened(path) as arrays:
        return dict(arrays.headers)


def is_table(path: Path) -> bool:
    """Whether a file of arrays holds no pictures: folders have such beside them."""
    suffix = path.suffix.lower()
    return suffix in FORMATS and suffix not in HDF5_SUFFIXES and kind_of_arrays(path) == "other"


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
    """A `Recording` of the pictures in an array of a file."""

    def __init__(self, path: Path, levels: Levels | None = None) -> None:
        """path: FILE or FILE::NAME.  levels: what shows as black and white; None: numbers as are.

        Raises FactoryError when it holds no pictures, or several arrays of them and none is named.
        """
        file, self._name = split_name(path)
        self.levels = levels
        super().__init__(file)

    def _open(self) -> None:
        self._arrays = _open(self.path)
        headers = self._arrays.headers
        name = self._name
        if name is not None and name not in headers:
            held = f"; it has {_named(headers)}" if headers else ""
            raise FrameError(f"{self.path}: holds no pictures named {name}{held}")
        if not headers:
            held = self._arrays.held
            shapes = _MATLAB if self.path.suffix.lower() == ".mat" else _KINDS
            raise FrameError(
                f"{self.path}: {f'{held} holds' if held else 'holds'} no pictures; expected "
                f"{shapes}, {LEAST_SIDE_PX} pixels or more on a side"
            )
        if name is None and len(headers) > 1:
            first = next(iter(headers))
            raise FrameError(
                f"{self.path}: holds several arrays of pictures: {_named(headers)}; name one, "
                f"{self.path.name}::{first}"
            )
        self.name = name or next(iter(headers))
        self.header = headers[self.name]
        height, width = self.header.shape[1:3]
        if height * width > MOST_PIXELS:
            raise FrameError(f"{self.path}: {width} x {height} pixels are more than can be read")

    def __len__(self) -> int:
        return self.header.shape[0]

    def page(self, number: int) -> npt.NDArray[Any]:
        """A picture as it is stored, colours in BGR order.  Raises FrameError."""
        with _one_line(f"{self.path}: picture {number + 1} cannot be read; is the file damaged?"):
            return np.ascontiguousarray(swapped(self._arrays.page(self.name, number)))

    def _read(self, number: int) -> Frame:
        what = f"{self.path}: picture {number + 1}"
        if self.header.single:
            what = str(self.path)
        page = self.page(number)
        shown = as_samples(page, what) if self.levels is None else self.levels.shown(page)
        return Frame(number, shown)

    def stored(self, number: int, picture: Samples) -> Samples:
        """What became of picture `number` as the file has its numbers, where levels were told."""
        if self.levels is None:
            return picture
        return self.levels.stored(picture, self.page(number))

    def copy_with_others(self, path: Path) -> ArrayCopy:
        """A copy of the file at `path`, whose pictures are given anew."""
        return ArrayCopy(self._arrays.rewriting(self.name, path), self.header.dtype)

    def close(self) -> None:
        """See `Recording`."""
        if hasattr(self, "_arrays"):
            self._arrays.close()
        super().close()


class ArrayCopy:
    """Takes pictures in order, as the file's dtype; close it."""

    def __init__(self, rewriting: Rewriting, dtype: np.dtype[Any]) -> None:
        self._rewriting, self._dtype = rewriting, dtype

    def add(self, picture: Samples) -> None:
        """The next picture, (H, W) or (H, W, colours) in BGR order."""
        self._rewriting.add(swapped(picture).astype(self._dtype))

    def close(self) -> None:
        """Write what is left."""
        self._rewriting.close()


def _open(path: Path) -> Arrays:
    module, name = FORMATS[path.suffix.lower()].split(":")
    with _one_line(f"{path}: not a readable file of arrays ({path.suffix.lower()})"):
        arrays: Arrays = getattr(import_module(module), name)(path)
    return arrays


@contextmanager
def _opened(path: Path) -> Iterator[Arrays]:
    arrays = _open(path)
    try:
        yield arrays
    finally:
        arrays.close()


@contextmanager
def _one_line(words: str) -> Iterator[None]:
    """FrameError for what a damaged file makes a library raise, which is nearly anything."""
    try:
        yield
    except FrameError:
        raise
    except FactoryError as error:
        raise FrameError(str(error)) from error
    except Exception as error:
        raise FrameError(words) from error


def _named(headers: Mapping[str, Header]) -> str:
    shown = [f"{name} {header}" for name, header in list(headers.items())[:_NAMED]]
    more = f" and {len(headers) - _NAMED} more" if len(headers) > _NAMED else ""
    return ", ".join(shown) + more
