"""An array of images in a file, described without being unpacked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

LEAST_SIDE_PX = 16
"""Smaller arrays are tables: poses, matrices, bearings."""
_CHANNELS = ((1,), (2,), (3,), (4,))

Row = list[Any]
"""[name, shape, dtype] of an array, as an isolated process can return it; see `Listed.matlab_shape`
for a fourth."""


@dataclass(frozen=True)
class Listed:
    """An array in a file, not unpacked.

    shape: the number of the image first.  parts: how many of its images are whole where the file
    is cut short; None: all.  matlab_shape: of an array of MATLAB whose first axis could count
    images as well as its last, which is taken; None: of others.
    """

    name: str
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    parts: int | None = None
    matlab_shape: tuple[int, ...] | None = None

    @property
    def is_single(self) -> bool:
        """Whether it is one image, without an axis for their number."""
        return has_one_image(self.shape)

    @property
    def is_of_images(self) -> bool:
        """Whether it may be images: numbers, large enough, of a known number of channels."""
        pages = (1, *self.shape) if self.is_single else self.shape
        fits = len(pages) == 3 or (len(pages) == 4 and pages[3:] in _CHANNELS)
        is_large = fits and pages[0] > 0 and min(pages[1:3]) >= LEAST_SIDE_PX
        return self.dtype.kind in "uif" and is_large


def has_one_image(shape: Sequence[int]) -> bool:
    """Whether an array of this shape is one image, without an axis for their number."""
    return len(shape) == 2 or tuple(shape[2:]) in _CHANNELS


def listed_of_rows(rows: Sequence[Row]) -> list[Listed]:
    """The arrays that the rows describe."""
    listed = []
    for name, shape, kind, *matlab_shapes in rows:
        matlab_shape = tuple(matlab_shapes[0]) if matlab_shapes else None
        listed.append(Listed(name, tuple(shape), np.dtype(kind), matlab_shape=matlab_shape))
    return listed
