"""Compiled passes over a row of pixels: where they are, and what the noise tiles say there.

Each pass is one loop without branches over arrays of one row, so that the compiler does several
pixels at a time; a look-up waits for no arithmetic, and many wait for memory at once.
Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled
from ..fields import FINE_M, STEPS, TEXTURE_M

_F = np.float32
_STEP = _F(1 / STEPS)
_FINE = _F(0.8 / STEPS)  # looked up between four pixels, it would vary that much less
_ZERO, _ONE = _F(0), _F(1)
_TEXTURE_RATE, _FINE_RATE = _F(1 / TEXTURE_M), _F(1 / FINE_M)
FAR = _F(200)


@compiled()
def byte(word: Any, number: int) -> Any:
    """Signed byte `number` of a 32-bit word, 0 the lowest, as a float32."""
    return _F(np.int32(np.int32(word << np.int32(24 - 8 * number)) >> np.int32(24)))


@compiled()
def place(
    depth_m: Any,
    normals: Any,
    dither: Any,
    across: Any,
    y0: Any,
    eye: Any,
    axes: Any,
    farthest_m: Any,
    points: Any,
    near: Any,
    glow: Any,
    axis: Any,
) -> None:
    """Points (3, W) of a row, their range (`FAR` from farthest_m on) and the water's glow.

    depth_m, dither, across: (W,).  normals: (3 W,).  y0: of the row's rays, as across of columns.
    Written, too: axis (W,), which the tiles are laid on from: by chance, in proportion to the
    normal.
    """
    ax, ay, az = _F(axes[0, 0]), _F(axes[1, 0]), _F(axes[2, 0])
    bx, by, bz = _F(axes[0, 1]) * y0, _F(axes[1, 1]) * y0, _F(axes[2, 1]) * y0
    cx, cy, cz = _F(axes[0, 2]), _F(axes[1, 2]), _F(axes[2, 2])
    ex, ey, ez = _F(eye[0]), _F(eye[1]), _F(eye[2])
    xs, ys, zs = points[0], points[1], points[2]
    for column in range(len(depth_m)):
        x0 = across[column]
        toward_x, toward_y, toward_z = ax * x0 + bx + cx, ay * x0 + by + cy, az * x0 + bz + cz
        length = np.sqrt(_ONE + x0 * x0 + y0 * y0)
        lift = min(max(toward_z / length + _F(0.35), _ZERO), _ONE)
        glow[column] = _F(0.72) + _F(0.9) * lift * lift
        range_m = depth_m[column] * length
        seen = range_m < farthest_m
        near[column] = min(range_m, FAR) if seen else FAR
        depth = depth_m[column] if seen else _ZERO
        xs[column], ys[column], zs[column] = (
            ex + depth * toward_x,
            ey + depth * toward_y,
            ez + depth * toward_z,
        )
    for column in range(len(depth_m)):
        nx, ny, nz = normals[3 * column], normals[3 * column + 1], normals[3 * column + 2]
        sx, sy, sz = nx * nx, ny * ny, nz * nz
        sx, sy, sz = sx * sx, sy * sy, sz * sz
        chance = dither[column] * (sx + sy + sz)
        axis[column] = 0 if chance < sx else 1 if chance < sx + sy else 2


@compiled()
def seek(points: Any, axis: Any, offset: Any, side: Any, at: Any, part: Any) -> None:
    """Where a row's points lie on the texture (the pixel, and how far beyond) and the fine tile.

    points: (3, W).  axis: (W,).  offset: (2,) metres.  side: pixels of the texture.
    Written: at (3, W) column and row of the texture, number of the fine pixel; part (2, W).
    """
    xs, ys, zs = points[0], points[1], points[2]
    lefts, tops, numbers = at[0], at[1], at[2]
    rights, downs = part[0], part[1]
    last, fine_side = side - 1, side // 2
    scale, fine_scale = _F(side), _F(fine_side)
    for column in range(len(axis)):
        way = axis[column]
        u = (ys[column] if way == 0 else xs[column]) + offset[0]
        v = (ys[column] if way == 2 else zs[column]) + offset[1]
        at_x, at_y = u * _TEXTURE_RATE, v * _TEXTURE_RATE
        at_x, at_y = (at_x - np.floor(at_x)) * scale, (at_y - np.floor(at_y)) * scale
        left, top = np.int32(at_x), np.int32(at_y)
        rights[column], downs[column] = at_x - _F(left), at_y - _F(top)
        lefts[column], tops[column] = left & last, top & last
        # What is finer than the picture: one pixel of the tile will do.
        at_x, at_y = u * _FINE_RATE, v * _FINE_RATE
        left = np.int32((at_x - np.floor(at_x)) * fine_scale) & (fine_side - 1)
        top = np.int32((at_y - np.floor(at_y)) * fine_scale) & (fine_side - 1)
        numbers[column] = top * fine_side + left


@compiled()
def look(texture: Any, at: Any, part: Any, words: Any, found: Any) -> None:
    """Channels (4, W) of the (S, S) texture at places of `seek`, between its pixels.

    words: (4, W) int32, overwritten: fetched one by one, and taken apart several at a time.
    """
    lefts, tops, rights, downs = at[0], at[1], part[0], part[1]
    broad, grain, cells, speckle = found[0], found[1], found[2], found[3]
    first, second, third, fourth = words[0], words[1], words[2], words[3]
    flat = texture.reshape(-1)
    side = np.uint32(texture.shape[0])
    last = np.uint32(side - 1)
    for column in range(len(lefts)):
        left, top = np.uint32(lefts[column]), np.uint32(tops[column])
        beside, below = (left + np.uint32(1)) & last, (top + np.uint32(1)) & last
        first[column], second[column] = flat[top * side + left], flat[top * side + beside]
        third[column], fourth[column] = flat[below * side + left], flat[below * side + beside]
    for column in range(len(lefts)):
        a, b, c, d = first[column], second[column], third[column], fourth[column]
        right, down = rights[column], downs[column]
        broad[column] = _between(byte(a, 0), byte(b, 0), byte(c, 0), byte(d, 0), right, down)
        grain[column] = _between(byte(a, 1), byte(b, 1), byte(c, 1), byte(d, 1), right, down)
        cells[column] = _between(byte(a, 2), byte(b, 2), byte(c, 2), byte(d, 2), right, down)
        speckle[column] = _between(byte(a, 3), byte(b, 3), byte(c, 3), byte(d, 3), right, down)


@compiled()
def _between(a: Any, b: Any, c: Any, d: Any, right: Any, down: Any) -> Any:
    upper, lower = a + right * (b - a), c + right * (d - c)
    return (upper + down * (lower - upper)) * _STEP


@compiled()
def look_close(fine: Any, numbers: Any, words: Any, found: Any) -> None:
    """Channels (6, W) of the (S, S, 2) fine tile at the pixels of these numbers.

    words: (4, W) int32, overwritten.
    """
    flat = fine.reshape(-1)
    broad, grain, cells, speckle = found[0], found[1], found[2], found[3]
    along_u, along_v = found[4], found[5]
    first, second = words[0], words[1]
    for column in range(len(numbers)):
        number = np.uint32(2 * numbers[column])
        first[column], second[column] = flat[number], flat[number + np.uint32(1)]
    for column in range(len(numbers)):
        here, gradient = first[column], second[column]
        broad[column] = byte(here, 0) * _FINE
        grain[column] = byte(here, 1) * _FINE
        cells[column] = byte(here, 2) * _FINE
        speckle[column] = byte(here, 3) * _FINE
        along_u[column] = byte(gradient, 0) * _FINE
        along_v[column] = byte(gradient, 1) * _FINE
