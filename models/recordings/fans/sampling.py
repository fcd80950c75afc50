"""Pixels of an image that lie nearest to points."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ....factory.common.array_types import Array, Bools, Float64s


class Samples(NamedTuple):
    """Values of the pixels nearest to points, 0 outside the image, and which are inside."""

    values: Array
    is_inside: Bools


def nearest_pixels(
    row: Float64s, column: Float64s, height: int, width: int
) -> npt.NDArray[np.intp]:
    """Index of the nearest pixel in the flattened image for each point; -1 outside the image."""
    row, column = np.broadcast_arrays(row, column)
    nearest_row = np.rint(row).astype(np.intp)
    nearest_column = np.rint(column).astype(np.intp)
    is_inside = (nearest_row >= 0) & (nearest_row < height)
    is_inside &= (nearest_column >= 0) & (nearest_column < width)
    return np.where(is_inside, nearest_row * width + nearest_column, -1)


def sample_nearest(image: Array, row: Float64s, column: Float64s) -> Samples:
    """Sample an image (H, W) at points."""
    pixels = nearest_pixels(row, column, *image.shape)
    is_inside = pixels >= 0
    values = image.ravel()[np.maximum(pixels, 0)]
    return Samples(is_inside * values, is_inside)
