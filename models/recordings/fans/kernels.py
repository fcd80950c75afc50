"""Compiled loops over the columns of a sector; see `simnfnd.factory.common.compiled`.

A fit counts the pixels of some 2,000 sectors.  A sector is a tuple of the fields of
`sector.Sector`, in their order.
"""

from __future__ import annotations

import math

import numpy as np

from ....factory.common.array_types import Bools, Float64s, Int32s, UInt8s
from ....factory.common.compiled import compiled

SectorFields = tuple[float, ...]
_SECTOR = "UniTuple(float64, 7)"


@compiled("int32[:, ::1](Array(boolean, 2, 'C', readonly=True))")
def lit_above_rows(lit: Bools) -> Int32s:
    """(H + 2, W) lit pixels above the upper border of each row of an image (H, W), by column.

    The last sum is there twice, as a border at the end of the image is followed by no further row.
    """
    height, width = lit.shape
    sums = np.zeros((height + 2, width), np.int32)
    for row in range(height):
        for column in range(width):
            sums[row + 1, column] = sums[row, column] + np.int32(lit[row, column])
    for column in range(width):
        sums[height + 1, column] = sums[height, column]
    return sums


@compiled()
def _row_spans(
    sector: SectorFields, first_column: int, column_step: int, count: int
) -> tuple[Float64s, Float64s]:
    """(count,) first and last rows, with fractions, of a sector in every n-th column of an image.

    A column meets a sector in one span of rows.  It begins at the far arc and ends at the near arc
    or at an edge, whichever comes first.  Beside the sector the last row is above the first.
    """
    first_rows = np.empty(count)
    last_rows = np.empty(count)
    apex_x, apex_y, far_px, near_px, left_tangent, right_tangent, squeeze = sector
    for index in range(count):
        # Of 32 bits, as processors turn several of these into floats at a time, but not of 64.
        column = float(np.int32(index)) * column_step + first_column
        across = (column - apex_x) / squeeze
        # Distances ahead of the apex, along y.
        far_ahead = math.sqrt(max(far_px * far_px - across * across, 0.0))
        near_ahead = math.sqrt(max(near_px * near_px - across * across, 0.0))
        # An edge lies ahead in columns of its own side, and behind the apex in the others.
        edge_ahead = max(across / left_tangent, across / right_tangent)
        first_rows[index] = apex_y - far_ahead
        last_rows[index] = apex_y - max(near_ahead, edge_ahead)
    return first_rows, last_rows


@compiled()
def _lit_above(sums: Int32s, border: float, column: int) -> float:
    """Lit pixels of a column above a border; a lit pixel that it cuts counts by its part above."""
    row = int(border)
    lit_above_row = int(sums[row, column])
    is_lit = int(sums[row + 1, column]) - lit_above_row
    return (border - row) * is_lit + lit_above_row


@compiled(f"UniTuple(float64, 2)(Array(int32, 2, 'C', readonly=True), {_SECTOR}, int64, boolean)")
def count_pixels(
    sums: Int32s, sector: SectorFields, column_step: int, whole: bool
) -> tuple[float, float]:
    """Pixels in a sector, and how many of them are lit, in every n-th column.

    sums: of `lit_above_rows`.  whole: pixels whose centres lie in the sector count, else the parts
    of pixels that do.
    """
    height = float(sums.shape[0] - 2)
    first_column = column_step // 2
    count = (sums.shape[1] - first_column + column_step - 1) // column_step
    first_rows, last_rows = _row_spans(sector, first_column, column_step, count)
    area = 0.0
    lit = 0.0
    for index in range(count):
        # The sums begin at the upper border of row 0, half a row above its centre.
        upper = first_rows[index] + 0.5
        lower = last_rows[index] + 0.5
        if whole:
            upper = np.ceil(upper - 0.5)
            lower = np.floor(lower + 0.5)
        upper = max(upper, 0.0)
        lower = min(lower, height)
        if upper >= lower:
            continue
        column = first_column + index * column_step
        area += lower - upper
        lit += _lit_above(sums, lower, column) - _lit_above(sums, upper, column)
    return area, lit


@compiled(f"uint8[:, ::1]({_SECTOR}, int64, int64)")
def sector_mask(sector: SectorFields, height: int, width: int) -> UInt8s:
    """(height, width), 1 where the centre of a pixel lies in a sector, 0 elsewhere."""
    mask = np.zeros((height, width), np.uint8)
    first_rows, last_rows = _row_spans(sector, 0, 1, width)
    for row in range(height):
        for column in range(width):
            mask[row, column] = first_rows[column] <= row <= last_rows[column]
    return mask
