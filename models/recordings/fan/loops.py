"""Sums over the columns of a picture that hold an outline of a fan against it.

The outline is that of `simnfnd.models.recordings.fan.outline`, which says what the numbers mean.
NumPy does them fast enough: `simnfnd denoise` needs no compiled loops, which take long to load.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Numbers = npt.NDArray[np.float64]


def column_limits(fan: Numbers, x: Numbers) -> tuple[Numbers, Numbers]:
    """First and last row of the sector in each column; last < first where it has none.

    fan: apex_x, apex_y, far_px, near_px, tangents of the left and the right edge's bearings, and
        pixels along x for one along y.
    x: (W,) columns.  Returns (W,) fractions of a row, twice.
    """
    apex_x, apex_y, far, near, left, right, squeeze = fan
    across = (x - apex_x) / squeeze
    ahead_far = np.sqrt(np.maximum(far * far - across * across, 0.0))
    ahead_near = np.sqrt(np.maximum(near * near - across * across, 0.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        edge = np.where(across < 0, across / left, across / right)
    return apex_y - ahead_far, apex_y - np.maximum(edge, ahead_near)


def lit_above(lit: npt.NDArray[np.bool_]) -> npt.NDArray[np.int32]:
    """(H + 1, W) int32: how many of the pixels above each row's upper border are lit."""
    count = np.zeros((lit.shape[0] + 1, lit.shape[1]), np.int32)
    np.cumsum(lit, axis=0, dtype=np.int32, out=count[1:])
    return count


def lit_inside(
    above: npt.NDArray[np.int32], fan: Numbers, step: int, whole: bool
) -> tuple[float, float]:
    """(lit pixels, pixels) in the sector, of every `step`-th column.

    above: see `lit_above`.  fan: see `column_limits`.  whole: a pixel counts if its centre is in
    the sector; else parts of pixels count as such, which is smoother and draws the outline outward.
    """
    height = above.shape[0] - 1
    columns = np.arange(step // 2, above.shape[1], step)
    # Pixel r reaches from r - 0.5 to r + 0.5.
    first, last = (limit + 0.5 for limit in column_limits(fan, columns.astype(np.float64)))
    if whole:
        first, last = np.ceil(first - 0.5), np.floor(last + 0.5)
    first, last = np.clip(first, 0.0, height), np.clip(last, 0.0, height)
    apex_x, far, squeeze = fan[0], fan[2], fan[6]
    across = (columns - apex_x) / squeeze
    shown = (last > first) & (across * across < far * far)
    if not shown.any():
        return 0.0, 0.0
    columns, first, last = columns[shown], first[shown], last[shown]
    terms = np.empty((len(columns), 4))
    for at, (rows, sign) in enumerate(((last, 1.0), (first, -1.0))):
        row = rows.astype(np.int64)
        here, below = above[row, columns], above[np.minimum(row + 1, height), columns]
        terms[:, 2 * at] = sign * here
        terms[:, 2 * at + 1] = sign * (rows - row) * (below - here)
    # One after the other, so that the sums do not depend on how NumPy splits them.
    return float(np.cumsum(terms)[-1]), float(np.cumsum(last - first)[-1])
