"""Pixels of an image: how many lie in a sector, lit and all, and those nearest to points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ....factory.common.array_types import Array, Bools, Float64s, Int64s
from .sector import Sector, row_spans


class PixelCounts(NamedTuple):
    """Pixels in a sector, and how many of them are lit; parts of pixels count.

    Numbers for one sector, (S,) for several.
    """

    area: Any
    lit: Any

    @property
    def black(self) -> Any:
        """Pixels in the sector that are not lit."""
        return self.area - self.lit


class LitPixels:
    """The lit pixels of an image (H, W), summed down each column.

    A column meets a sector in one span of rows.  Its lit pixels are those above the lower border of
    the span less those above the upper border: two look-ups in the sums, however long the span is.

    width: columns of the image.  pixel_count, lit_count: of all of it.
    """

    def __init__(self, lit: Bools) -> None:
        """lit: (H, W), whether a pixel is lit."""
        height, width = lit.shape
        # By column, so that both look-ups of a border lie side by side.  A border at the end of the
        # image is followed by no further row: the last sum is there twice.
        sums = np.zeros((width, height + 2), np.int32)
        np.cumsum(lit.T, axis=1, out=sums[:, 1:-1])
        sums[:, -1] = sums[:, -2]
        self._lit_above = sums.ravel()
        self._height = height
        self.width = width
        self.pixel_count = lit.size
        self.lit_count = int(lit.sum())

    def count_fractional(self, sector: Sector, column_step: int = 1) -> PixelCounts:
        """Count each pixel by the part of its height that lies in the sector.

        The counts change smoothly with the sector, as a fit needs it.

        column_step: only every n-th column counts.
        """
        columns = np.arange(column_step // 2, self.width, column_step)
        # The sums begin at the upper border of row 0, half a row above its centre.
        return self._count(row_spans(sector, columns) + 0.5, columns)

    def count_whole(self, sectors: Sequence[Sector], column_step: int = 1) -> PixelCounts:
        """Count the pixels whose centres lie in each of some sectors, each as a whole.

        Pixels were lit whole when the image was made, so that these counts place an edge better
        than those of parts, which draw it outward.

        column_step: only every n-th column counts.
        """
        columns = np.arange(column_step // 2, self.width, column_step)
        borders = row_spans(Sector(*np.array(sectors).T[:, :, None]), columns)
        np.ceil(borders[0], out=borders[0])
        np.floor(borders[1], out=borders[1])
        borders[1] += 1
        return self._count(borders, columns)

    def _count(self, borders: Float64s, columns: Int64s) -> PixelCounts:
        """Count the pixels between upper and lower borders, (2, n) or (2, S, n) rows of columns."""
        np.maximum(borders, 0.0, out=borders)
        np.minimum(borders, self._height, out=borders)
        np.maximum(borders[0], borders[1], out=borders[1])
        rows = borders.astype(np.intp)
        places = rows + columns * (self._height + 2)
        lit_above_rows = self._lit_above.take(places)
        places += 1
        # A lit pixel that a border cuts counts by its part above.
        lit_above = (borders - rows) * (self._lit_above.take(places) - lit_above_rows)
        lit_above += lit_above_rows
        upper_area, lower_area = np.add.reduce(borders, axis=-1)
        upper_lit, lower_lit = np.add.reduce(lit_above, axis=-1)
        return PixelCounts(lower_area - upper_area, lower_lit - upper_lit)


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
