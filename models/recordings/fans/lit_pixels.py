"""Counts the pixels, and the lit pixels, that lie in sectors of an image."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ....factory.common.array_types import Bools, Float64s
from .sector import Sector, row_spans


class PixelCounts(NamedTuple):
    """(N,) pixels in each of N sectors, and how many of them are lit; parts of pixels count."""

    area: Float64s
    lit: Float64s

    @property
    def black(self) -> Float64s:
        """(N,) pixels in each sector that are not lit."""
        return np.asarray(self.area - self.lit)


class LitPixels:
    """The lit pixels of an image (H, W), summed down each column.

    A column meets a sector in one span of rows.  Its lit pixels are those above the lower border of
    the span less those above the upper border: two look-ups in the sums, however long the span is.

    width: columns of the image.  pixel_count, lit_count: of all of it.
    """

    def __init__(self, lit: Bools) -> None:
        """lit: (H, W), whether a pixel is lit."""
        height, width = lit.shape
        # Row r holds the lit pixels above the upper border of row r.  The last sum is there twice,
        # as a border at the end of the image is followed by no further row.
        sums = np.zeros((height + 2, width), np.int32)
        np.cumsum(lit, axis=0, dtype=np.int32, out=sums[1:-1])
        sums[-1] = sums[-2]
        self._flat_sums = sums.ravel()
        self._height = height
        self.width = width
        self.pixel_count = lit.size
        self.lit_count = int(sums[-1].sum())

    def count_fractional(self, sectors: Sequence[Sector], column_step: int = 1) -> PixelCounts:
        """Count each pixel by the part of its height that lies in the sector.

        The counts change smoothly with the sector, as a fit needs it.

        column_step: only every n-th column counts.
        """
        columns = self._columns(column_step)
        # The sums begin at the upper border of row 0, half a row above its centre.
        borders = row_spans(sectors, columns.astype(np.float64)) + 0.5
        return self._count_between(borders, columns)

    def count_whole(self, sectors: Sequence[Sector], column_step: int = 1) -> PixelCounts:
        """Count the pixels whose centres lie in the sector, each as a whole.

        Pixels were lit whole when the image was made, so that these counts place an edge better
        than those of parts, which draw it outward.

        column_step: only every n-th column counts.
        """
        columns = self._columns(column_step)
        borders = row_spans(sectors, columns.astype(np.float64)) + 0.5
        borders[0] = np.ceil(borders[0] - 0.5)
        borders[1] = np.floor(borders[1] + 0.5)
        return self._count_between(borders, columns)

    def _columns(self, step: int) -> npt.NDArray[np.intp]:
        return np.arange(step // 2, self.width, step)

    def _count_between(self, borders: Float64s, columns: npt.NDArray[np.intp]) -> PixelCounts:
        """Count lit pixels between borders.

        borders: (2, N, W) upper and lower border of N sectors in W columns, rows.
        """
        borders = np.minimum(np.maximum(borders, 0.0), self._height)
        # A column beside the sector counts nothing.
        np.minimum(borders[0], borders[1], out=borders[0])

        lit_above = self._count_lit_above(borders, columns)
        return PixelCounts(
            area=_sum_columns(borders[1] - borders[0]),
            lit=_sum_columns(lit_above[1] - lit_above[0]),
        )

    def _count_lit_above(self, borders: Float64s, columns: npt.NDArray[np.intp]) -> Float64s:
        """Lit pixels above each border; a lit pixel that it cuts counts by its part above."""
        row = borders.astype(np.int64)
        part_above = borders - row
        index = row * self.width + columns
        above_row = self._flat_sums.take(index)
        above_next_row = self._flat_sums.take(index + self.width)
        is_lit = above_next_row - above_row
        return np.asarray(part_above * is_lit + above_row)


def _sum_columns(values: Float64s) -> Float64s:
    """(N,) sums of (N, W), added in order: they do not depend on how NumPy splits a sum."""
    return np.asarray(values.cumsum(axis=-1)[..., -1])
