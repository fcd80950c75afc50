"""Compiled loops that form pictures of echoes; see `simnfnd.factory.compiled`.

The wrappers around them say what they compute, and the tests hold each against numpy or scipy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..compiled import compiled
from ..elementary import FLOATS
from .echo_loops import PICTURE, cell, nearest_beam

_F = np.float32


@compiled(
    f"void({FLOATS}, {FLOATS}, {FLOATS}, boolean, float32, float32, int64, float32, float32, int64,"
    f"{FLOATS}, int32[::1])"
)
def bin_of_each(
    range_m: Any,
    azimuth_rad: Any,
    elevation_rad: Any,
    top_view: Any,
    near_m: Any,
    span_m: Any,
    rows: Any,
    left_rad: Any,
    per_rad: Any,
    columns: Any,
    edges_rad: Any,
    bins: Any,
) -> None:
    """`cell` of each echo, with the nearest of tabled beams where there are `edges_rad`."""
    for at in range(len(range_m)):
        bins[at] = cell(
            *(range_m[at], azimuth_rad[at], elevation_rad[at], top_view, near_m, span_m, rows),
            *(left_rad, per_rad, columns),
        )
    if len(edges_rad):
        for at in range(len(range_m)):
            if bins[at] != rows * columns:
                bins[at] = nearest_beam(bins[at], azimuth_rad[at], edges_rad, columns)


@compiled(f"void(int32[::1], {FLOATS}, int64, float32[::1], int32[::1])")
def gather(bins: Any, strength: Any, how: Any, level: Any, count: Any) -> None:
    """Add the echoes (how = 0), or keep the loudest (how = 1), in `level`; how many in `count`.

    The last cell of either is for echoes without a bin.  how = 2 adds and counts.
    """
    if how == 1:
        for at in range(len(bins)):
            level[bins[at]] = max(level[bins[at]], strength[at])
        return
    for at in range(len(bins)):
        level[bins[at]] += strength[at]
    if how == 2:
        for at in range(len(bins)):
            count[bins[at]] += strength[at] > _F(0)


@compiled()
def _add(values: Any, weight: Any, total: Any) -> None:
    # Slices from 0 on: the compiler then knows that no index is negative.
    for at in range(len(total)):
        total[at] += weight * values[at]


@compiled()
def _or(values: Any, total: Any) -> None:
    for at in range(len(total)):
        total[at] |= values[at]


@compiled()
def _and(values: Any, total: Any) -> None:
    for at in range(len(total)):
        total[at] &= values[at]


@compiled(f"void({PICTURE}, {FLOATS}, {FLOATS}, float32[:, ::1])")
def blur(level: Any, down: Any, across: Any, blurred: Any) -> None:
    """Correlate with two odd kernels, along rows and columns; nothing lies outside."""
    rows, columns = level.shape
    reach, side = len(down) // 2, len(across) // 2
    wide = np.zeros(columns + 2 * side, _F)
    line = wide[side : side + columns]
    for row in range(rows):
        line[:] = _F(0)
        for step in range(max(-reach, -row), min(reach, rows - 1 - row) + 1):
            _add(level[row + step], down[step + reach], line)
        blurred[row] = _F(0)
        for step in range(len(across)):
            _add(wide[step : step + columns], across[step], blurred[row])


@compiled("void(boolean[:, ::1], int64, int64, boolean[:, ::1])")
def close(hit: Any, reach: Any, side: Any, closed: Any) -> None:
    """Morphological closing by a (2 reach + 1) x (2 side + 1) box; nothing lies outside."""
    rows, columns = hit.shape
    # The dilation reaches beyond the picture, and the erosion looks at that.
    high, wide = rows + 2 * reach, columns + 4 * side
    tall = np.zeros((high, wide), np.uint8)
    broad = np.zeros((high, wide), np.uint8)
    line, whole = np.empty(wide, np.uint8), np.empty(columns, np.uint8)
    source = hit.view(np.uint8)
    for row in range(rows):
        for step in range(2 * reach + 1):
            _or(source[row], tall[row + step, 2 * side : 2 * side + columns])
    for row in range(high):
        for step in range(2 * side + 1):
            _or(tall[row, step : step + wide - 2 * side], broad[row, side : wide - side])
    for row in range(rows):
        line[:] = 1
        for step in range(2 * reach + 1):
            _and(broad[row + step], line)
        whole[:] = 1
        for step in range(2 * side + 1):
            _and(line[side + step : side + step + columns], whole)
        for column in range(columns):
            closed[row, column] = whole[column] != 0


@compiled(
    f"void({PICTURE}, Array(int32, 1, 'C', readonly=True), Array(int32, 1, 'C', readonly=True),"
    f"{FLOATS}, {FLOATS}, float32[::1])"
)
def bilinear(polar: Any, pixel: Any, corner: Any, down: Any, across: Any, fan: Any) -> None:
    """fan[pixel] = the four bins from `corner` on, mixed by the fractions down and across."""
    flat, columns = polar.ravel(), polar.shape[1]
    one = _F(1)
    for at in range(len(pixel)):
        bin_, u, v = corner[at], down[at], across[at]
        near = flat[bin_] * (one - v) + flat[bin_ + 1] * v
        far = flat[bin_ + columns] * (one - v) + flat[bin_ + columns + 1] * v
        fan[pixel[at]] = near * (one - u) + far * u
