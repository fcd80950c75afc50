"""Counts the pixels, and the lit pixels, that lie in a sector of an image."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ....factory.common.array_types import Bools
from .sector import Sector


class PixelCounts(NamedTuple):
    """Pixels in a sector, and how many of them are lit; parts of pixels count."""

    area: float
    lit: float

    @property
    def black(self) -> float:
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
        from . import kernels  # loads numba

        self._sums = kernels.lit_above_rows(np.ascontiguousarray(lit))
        self._count_pixels = kernels.count_pixels
        self.width = lit.shape[1]
        self.pixel_count = lit.size
        self.lit_count = int(lit.sum())

    def count_fractional(self, sector: Sector, column_step: int = 1) -> PixelCounts:
        """Count each pixel by the part of its height that lies in the sector.

        The counts change smoothly with the sector, as a fit needs it.

        column_step: only every n-th column counts.
        """
        return self._count(sector, column_step, whole=False)

    def count_whole(self, sector: Sector, column_step: int = 1) -> PixelCounts:
        """Count the pixels whose centres lie in the sector, each as a whole.

        Pixels were lit whole when the image was made, so that these counts place an edge better
        than those of parts, which draw it outward.

        column_step: only every n-th column counts.
        """
        return self._count(sector, column_step, whole=True)

    def _count(self, sector: Sector, column_step: int, whole: bool) -> PixelCounts:
        return PixelCounts(*self._count_pixels(self._sums, tuple(sector), column_step, whole))
