"""Compiled loops over the grid of the ground: its normals, its fine relief, and what shades it.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled
from .field_loops import READ, ROWS

_F = np.float32
_ZERO, _ONE = _F(0), _F(1)
_PLANE, _VECTORS = "float32[:, ::1]", "float32[:, :, ::1]"


@compiled()
def _row_of_normals(here: Any, above: Any, below: Any, columns: int, normals: Any) -> None:
    for column in range(columns):
        left, right = 3 * max(column - 1, 0), 3 * min(column + 1, columns - 1)
        at = 3 * column
        dx, dy, dz = (
            below[at] - above[at],
            below[at + 1] - above[at + 1],
            below[at + 2] - above[at + 2],
        )
        rx, ry, rz = (
            here[right] - here[left],
            here[right + 1] - here[left + 1],
            here[right + 2] - here[left + 2],
        )
        x, y, z = ry * dz - rz * dy, rz * dx - rx * dz, rx * dy - ry * dx
        up = -_ONE if z < 0 else _ONE
        x, y, z = x * up, y * up, z * up
        length = max(np.sqrt(x * x + y * y + z * z), _F(1e-20))
        normals[at], normals[at + 1], normals[at + 2] = x / length, y / length, z / length


@compiled(f"void({_VECTORS}, {_VECTORS})")
def normals_of_grid(points: Any, normals: Any) -> None:
    """(R, C, 3) unit normals of a grid of points, turned upward, by central differences."""
    rows, columns = points.shape[:2]
    for row in range(rows):
        # Flat, so that the compiler knows the steps from point to point.
        above, below = points[max(row - 1, 0)], points[min(row + 1, rows - 1)]
        _row_of_normals(
            points[row].reshape(-1), above.reshape(-1), below.reshape(-1), columns,
            normals[row].reshape(-1),
        )  # fmt: skip


@compiled()
def _tile_at(tile: Any, u_m: Any, v_m: Any, scale: Any) -> Any:
    """Value of a periodic tile between its pixels; see `field_loops.look_up`."""
    side = tile.shape[0]
    x, y = u_m * scale, v_m * scale
    x, y = (x - np.floor(x)) * _F(side), (y - np.floor(y)) * _F(side)
    column, row = int(x), int(y)
    right, down = x - _F(column), y - _F(row)
    column, row = column & (side - 1), row & (side - 1)
    after, below = (column + 1) & (side - 1), (row + 1) & (side - 1)
    upper = tile[row, column] + right * (tile[row, after] - tile[row, column])
    lower = tile[below, column] + right * (tile[below, after] - tile[below, column])
    return upper + down * (lower - upper)


@compiled(
    f"void({_VECTORS}, {_VECTORS}, {_PLANE}, {_PLANE}, {_PLANE}, {ROWS}, {ROWS}, float32[::1], "
    f"float32[::1], {_VECTORS})"
)
def relieve(
    points: Any,
    normals: Any,
    rock: Any,
    gravel: Any,
    crest: Any,
    rock_tile: Any,
    sand_tile: Any,
    offset: Any,
    heights: Any,
    attributes: Any,
) -> None:
    """Move points (R, C, 3) of the ground along their normals by its fine relief.

    rock, gravel, crest: (R, C) rockiness, share of gravel, ripples.  heights: (3,) metres of a
    standard deviation of rock and sand, and of a ripple's crest.
    Written, too: attributes (R, C, 3), see `Terrain.surface`.
    """
    rock_m, sand_m, crest_m = heights[0], heights[1], heights[2]
    coarse, fine = _ONE / _F(9.1), _ONE / _F(2.3)
    sandy, pebbly = _ONE / _F(6.7), _ONE / _F(1.7)
    first, second = offset[0], offset[1]
    for row in range(points.shape[0]):
        for column in range(points.shape[1]):
            x, y, z = points[row, column, 0], points[row, column, 1], points[row, column, 2]
            nx, ny, nz = normals[row, column, 0], normals[row, column, 1], normals[row, column, 2]
            bare, pebbles, ripple = rock[row, column], gravel[row, column], crest[row, column]
            stone = sand = stones = _ZERO
            if bare > 0:
                # The tile is laid on from the three axes and mixed by the normal.
                sx, sy, sz = nx * nx, ny * ny, nz * nz
                sx, sy, sz = sx * sx, sy * sy, sz * sz
                total = max(sx + sy + sz, _F(1e-12))
                sx, sy, sz = sx / total, sy / total, sz / total
                px, py, pz = x + first, y + first, z + second
                qy = y + second
                stone = sx * _tile_at(rock_tile, py, pz, coarse)
                stone += sy * _tile_at(rock_tile, px, pz, coarse)
                stone += sz * _tile_at(rock_tile, px, qy, coarse)
                small = sx * _tile_at(rock_tile, py, pz, fine)
                small += sy * _tile_at(rock_tile, px, pz, fine)
                small += sz * _tile_at(rock_tile, px, qy, fine)
                stone += _F(0.35) * small
            loose = _ONE - bare
            if loose != 0:
                sand = _tile_at(sand_tile, x + first, y + second, sandy)
            if pebbles != 0:
                stones = _tile_at(rock_tile, x + first, y + second, pebbly)
            relief = rock_m * bare * stone + sand_m * loose * sand
            relief += _F(0.011) * pebbles * stones
            relief += crest_m * ripple
            tone = _F(0.4) * sand + _F(0.8) * ripple + _F(0.5) * pebbles * stones
            points[row, column, 0] = x + nx * relief
            points[row, column, 1] = y + ny * relief
            points[row, column, 2] = z + nz * relief
            attributes[row, column, 0], attributes[row, column, 1] = bare, pebbles
            attributes[row, column, 2] = bare * stone + loose * tone


@compiled()
def _moved_by_light(points: Any, slope_x: Any, slope_y: Any, place: Any, x: Any, y: Any) -> None:
    left, top, scale = place[0], place[1], place[2]
    for k in range(len(x)):
        x[k] = (points[3 * k] - points[3 * k + 2] * slope_x - left) * scale
        y[k] = (points[3 * k + 1] - points[3 * k + 2] * slope_y - top) * scale


@compiled()
def _shading(x: Any, y: Any, below_x: Any, below_y: Any, turn: Any, side: Any, flags: Any) -> None:
    """Which cells of a row of the grid have a triangle that turns that way and meets the map."""
    for k in range(len(flags)):
        ax, ay = x[k], y[k]
        bx, by, cx, cy = below_x[k] - ax, below_y[k] - ay, below_x[k + 1] - ax, below_y[k + 1] - ay
        dx, dy = x[k + 1] - ax, y[k + 1] - ay
        one, two = (bx * cy - by * cx) * turn > 0, (cx * dy - cy * dx) * turn > 0
        left = min(min(x[k], x[k + 1]), min(below_x[k], below_x[k + 1])) <= side
        right = max(max(x[k], x[k + 1]), max(below_x[k], below_x[k + 1])) >= 0
        upper = min(min(y[k], y[k + 1]), min(below_y[k], below_y[k + 1])) <= side
        lower = max(max(y[k], y[k + 1]), max(below_y[k], below_y[k + 1])) >= 0
        flags[k] = (one | two) & left & right & upper & lower


@compiled(f"int64({_VECTORS}, {READ}, {READ}, float32, int64, int32[:, ::1])")
def shading_triangles(
    points: Any, slope: Any, place: Any, turn: Any, side: Any, triangles: Any
) -> int:
    """Triangles of a grid (R, C, 3) that may shade the rest: cells with one that turns that way.

    slope, place: see `raster_loops.cover`.  side: of its map.  triangles: (2 (R - 1) (C - 1), 3),
    the first of which are written.  Returns how many.
    """
    rows, columns = points.shape[:2]
    x, y = np.empty((2, columns), np.float32), np.empty((2, columns), np.float32)
    flags = np.empty(columns - 1, np.bool_)
    count, limit = 0, _F(side - 1)
    _moved_by_light(points[0].reshape(-1), slope[0], slope[1], place, x[0], y[0])
    for row in range(rows - 1):
        now, after = row & 1, (row + 1) & 1
        _moved_by_light(points[row + 1].reshape(-1), slope[0], slope[1], place, x[after], y[after])
        _shading(x[now], y[now], x[after], y[after], turn, limit, flags)
        for column in range(columns - 1):
            if flags[column]:
                a = row * columns + column
                b = a + columns
                triangles[count, 0], triangles[count, 1], triangles[count, 2] = a, b, b + 1
                count += 1
                triangles[count, 0], triangles[count, 1], triangles[count, 2] = a, b + 1, a + 1
                count += 1
    return count
