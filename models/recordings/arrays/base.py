"""What every format of arrays gives: which arrays are pictures, their pages, and a changed copy."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

Page = npt.NDArray[Any]

LEAST_SIDE_PX = 16
"""Smaller arrays are tables: poses, matrices, bearings."""
MOST_BYTES = 1 << 33
"""Of an array that its format reads as a whole."""
_COLOURS = (1, 3, 4)
MATLAB_CLASSES = {"double": "f8", "single": "f4"} | {
    f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4)
}
"""Class -> dtype; the others (logical, char, cell, struct, sparse) are no pictures."""


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
    elif len(shape) == 3:
        pages = (shape[2], *shape[:2]) if matlab else shape
    elif len(shape) == 4:
        pages = (shape[3], *shape[:3]) if matlab else shape
        if pages[3] not in colours:
            return None
    else:
        return None
    return Header(pages, dtype, single) if min(pages[1:3]) >= LEAST_SIDE_PX else None


class Rewriting(Protocol):
    """Takes the pages of one array in order; close it, and the copy of the file is whole."""

    def add(self, page: Page) -> None:
        """The next page, of the array's shape and dtype."""
        ...

    def close(self) -> None:
        """Write what is left, and close the file."""
        ...


class Arrays(ABC):
    """An opened file.

    headers: name -> array, of those that may be pictures.  held: what is there instead, where that
    can be said in few words.
    """

    headers: Mapping[str, Header]
    held = ""

    @abstractmethod
    def page(self, name: str, number: int) -> Page:
        """A picture as it is stored, (H, W) or (H, W, colours).  May raise nearly anything."""

    @abstractmethod
    def rewriting(self, name: str, path: Path) -> Rewriting:
        """A copy of the file at `path`, whose array of this name is given anew."""

    @abstractmethod
    def close(self) -> None:
        """Let go of the file."""
