"""Compiled loops that hold an outline of a fan against a picture; see `simnfnd.factory.compiled`.

The outline is that of `simnfnd.models.recordings.fan.outline`, which says what the numbers mean.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ....factory.compiled import compiled


@compiled("void(float64[::1], float64[::1], float64[::1], float64[::1])")
def column_limits(fan: Any, x: Any, top: Any, bottom: Any) -> None:
    """First and last row of the sector in each column; bottom < top where it has none.

    fan: apex_x, apex_y, far_px, near_px, tangents of the left and the right edge's bearings, and
        pixels along x for one along y.
    x: (W,) columns.  top, bottom: (W,) filled, fractions of a row.
    """
    apex_x, apex_y, far, near, left, right, squeeze = fan
    for at in range(len(x)):
        across = (x[at] - apex_x) / squeeze
        ahead_far = math.sqrt(max(far * far - across * across, 0.0))
        ahead_near = math.sqrt(max(near * near - across * across, 0.0))
        edge = across / left if across < 0 else across / right
        top[at] = apex_y - ahead_far
        bottom[at] = apex_y - max(edge, ahead_near)


@compiled("int32[:,::1](boolean[:,::1])")
def lit_above(lit: Any) -> Any:
    """(H + 1, W) int32: how many of the pixels above each row's upper border are lit."""
    height, width = lit.shape
    count = np.zeros((height + 1, width), np.int32)
    for row in range(height):
        for column in range(width):
            count[row + 1, column] = count[row, column] + lit[row, column]
    return count


@compiled("UniTuple(float64, 2)(int32[:,::1], float64[::1], int64, boolean)")
def lit_inside(above: Any, fan: Any, step: Any, whole: Any) -> Any:
    """(lit pixels, pixels) in the sector, of every `step`-th column.

    above: see `lit_above`.  fan: see `column_limits`.  whole: a pixel counts if its centre is in
    the sector; else parts of pixels count as such, which is smoother and draws the outline outward.
    """
    height = above.shape[0] - 1
    apex_x, apex_y, far, near, left, right, squeeze = fan
    lit = 0.0
    area = 0.0
    for column in range(step // 2, above.shape[1], step):
        across = (column - apex_x) / squeeze
        if across * across >= far * far:
            continue
        edge = across / left if across < 0 else across / right
        ahead_near = math.sqrt(max(near * near - across * across, 0.0))
        # Pixel r reaches from r - 0.5 to r + 0.5.
        first = apex_y - math.sqrt(far * far - across * across) + 0.5
        last = apex_y - max(edge, ahead_near) + 0.5
        if whole:
            first = math.ceil(first - 0.5)
            last = math.floor(last + 0.5)
        first = min(max(first, 0.0), float(height))
        last = min(max(last, 0.0), float(height))
        if last <= first:
            continue
        area += last - first
        row = int(last)
        lit += above[row, column]
        if row < height:
            lit += (last - row) * (above[row + 1, column] - above[row, column])
        row = int(first)
        lit -= above[row, column]
        if row < height:
            lit -= (first - row) * (above[row + 1, column] - above[row, column])
    return lit, area
