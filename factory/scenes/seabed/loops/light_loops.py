"""Compiled passes over a row of pixels: rough surfaces in the light, and what water leaves of it.

Each pass is one loop without branches that the compiler does several pixels at a time.
Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled
from .texture_loops import FAR

_F = np.float32
_ROUND = _F(12582912)
_LOG2E = _F(1 / np.log(2))
_E = tuple(_F(np.log(2) ** k / f) for k, f in enumerate((1, 1, 2, 6, 24, 120, 720)))
_ZERO, _ONE, _HALF = _F(0), _F(1), _F(0.5)


@compiled()
def exponential(x: Any) -> Any:
    """Exponential, float32, -80 <= x <= 80, within 2e-7 of its size: several at a time."""
    turns = x * _LOG2E
    whole = (turns + _ROUND) - _ROUND
    t = turns - whole
    series = _E[3] + t * (_E[4] + t * (_E[5] + t * _E[6]))
    mantissa = _ONE + t * (_E[1] + t * (_E[2] + t * series))
    bits = np.int32(np.int32(whole) + np.int32(127)) << np.int32(23)
    return mantissa * np.int32(bits).view(np.float32)


@compiled()
def spread(halves: Any, row: int, values: Any) -> None:
    """Values of a row of pixels from those of every second pixel, (h, w): the mean of four.

    values: (2 w,), one more than the row has where that is odd.
    """
    rows, columns = halves.shape
    upper = min(row >> 1, rows - 1)
    above, below = halves[upper], halves[min(upper + (row & 1), rows - 1)]
    for j in range(columns - 1):
        a, b, c, d = above[j], above[j + 1], below[j], below[j + 1]
        values[2 * j] = (a + a + c + c) * _F(0.25)
        values[2 * j + 1] = (a + b + c + d) * _F(0.25)
    a, c = above[columns - 1], below[columns - 1]
    values[2 * columns - 2] = values[2 * columns - 1] = (a + a + c + c) * _F(0.25)


@compiled()
def roughen(
    depth_m: Any,
    normals: Any,
    close_by: Any,
    axis: Any,
    bump: Any,
    near: Any,
    shine: Any,
    room: Any,
    sun: Any,
    turned: Any,
    came: Any,
) -> None:
    """Normals (3, W) tilted against the gradient of a rough surface, and what light they get.

    Written: turned; came[0] from the sun, came[1] from above.  See `colour_loops.photograph`.
    """
    along_us, along_vs = close_by[4], close_by[5]
    xs, ys, zs = turned[0], turned[1], turned[2]
    from_sun, from_above = came[0], came[1]
    sun_x, sun_y, sun_z = sun[0], sun[1], sun[2]
    for column in range(len(depth_m)):
        nx, ny, nz = normals[3 * column], normals[3 * column + 1], normals[3 * column + 2]
        along_u, along_v = along_us[column], along_vs[column]
        way = axis[column]
        close = min(max(_F(1.25) - depth_m[column] * _F(1 / 9), _ZERO), _ONE)
        height = bump[column] * (_F(0.25) + _F(0.75) * close)
        gx = _ZERO if way == 0 else along_u
        gy = along_u if way == 0 else _ZERO if way == 1 else along_v
        gz = _ZERO if way == 2 else along_v
        along = gx * nx + gy * ny + gz * nz
        nx -= height * (gx - along * nx)
        ny -= height * (gy - along * ny)
        nz -= height * (gz - along * nz)
        unit = _ONE / max(np.sqrt(nx * nx + ny * ny + nz * nz), _F(1e-6))
        nx, ny, nz = nx * unit, ny * unit, nz * unit
        xs[column], ys[column], zs[column] = nx, ny, nz
        lit = near[column] < FAR
        bright = max(nx * sun_x + ny * sun_y + nz * sun_z, _ZERO) * shine[column]
        from_sun[column] = bright if lit else _ZERO
        sky = room[column] * (_F(0.55) + _F(0.45) * nz)
        from_above[column] = sky if lit else _ZERO


@compiled()
def net_of_light(
    points: Any, sun: Any, caustic: Any, rate: Any, caustics: Any, at: Any, net: Any, from_sun: Any
) -> None:
    """Bunch sunlight (W,) in nets that follow the sun's rays down.

    points: (3, W) metres.  rate: tiles a metre.  caustics: the (S, S) tile, finer than the light's.
    at, net: (W,), overwritten: its pixels, fetched one by one.
    """
    flat, side = caustics.reshape(-1), caustics.shape[0]
    last, scale = side - 1, _F(side)
    slope_x, slope_y = sun[0] / sun[2], sun[1] / sun[2]
    xs, ys, zs = points[0], points[1], points[2]
    for column in range(len(from_sun)):
        net_x = (xs[column] - zs[column] * slope_x) * rate
        net_y = (ys[column] - zs[column] * slope_y) * rate
        left = np.int32((net_x - np.floor(net_x)) * scale) & last
        top = np.int32((net_y - np.floor(net_y)) * scale) & last
        at[column] = top * side + left
    for column in range(len(from_sun)):
        net[column] = flat[np.uint32(at[column])]
    for column in range(len(from_sun)):
        from_sun[column] *= _ONE + caustic * (net[column] - _ONE)


@compiled()
def shine_back(
    across: Any, y0: Any, axes: Any, turned: Any, near: Any, room: Any, from_lamp: Any
) -> None:
    """Light of the lamp at the camera (W,), bright in the middle of the picture."""
    ax, ay, az = _F(axes[0, 0]), _F(axes[1, 0]), _F(axes[2, 0])
    bx, by, bz = _F(axes[0, 1]) * y0, _F(axes[1, 1]) * y0, _F(axes[2, 1]) * y0
    cx, cy, cz = _F(axes[0, 2]), _F(axes[1, 2]), _F(axes[2, 2])
    xs, ys, zs = turned[0], turned[1], turned[2]
    for column in range(len(across)):
        x0 = across[column]
        toward_x, toward_y, toward_z = ax * x0 + bx + cx, ay * x0 + by + cy, az * x0 + bz + cz
        length = np.sqrt(_ONE + x0 * x0 + y0 * y0)
        facing = -(xs[column] * toward_x + ys[column] * toward_y + zs[column] * toward_z) / length
        beam = exponential(max((_ONE - length) * _F(1 / 0.11), _F(-30)))
        spreading = max(near[column], _HALF)
        light = max(facing, _ZERO) * (_F(0.4) + _F(0.6) * room[column])
        light = light * beam / (spreading * spreading)
        from_lamp[column] = light if near[column] < FAR else _ZERO


@compiled()
def through_water(albedo: Any, came: Any, near: Any, glow: Any, water: Any, colour: Any) -> None:
    """Colour (3, W) that reaches the camera of what came to surfaces of this albedo (3, W)."""
    from_sun, from_above, from_lamp = came[0], came[1], came[2]
    for k in range(3):
        fades, grows, veil = -water[0, k], -water[1, k], water[2, k]
        sunny, sky, lamp = water[3, k], water[4, k], water[5, k]
        tint, out = albedo[k], colour[k]
        for column in range(len(near)):
            fade = exponential(max(fades * near[column], _F(-30)))
            haze = _ONE - exponential(max(grows * near[column], _F(-30)))
            # The lamp's light fades on its way out as well as back.
            coming = sunny * from_sun[column] + sky * from_above[column]
            coming += lamp * from_lamp[column] * fade
            out[column] = tint[column] * coming * fade + veil * haze * glow[column]


@compiled()
def weave(planes: Any, mixed: Any) -> None:
    """(3 W,) of (3, W), the three numbers of a pixel side by side."""
    red, green, blue = planes[0], planes[1], planes[2]
    for column in range(len(red)):
        mixed[3 * column] = red[column]
        mixed[3 * column + 1] = green[column]
        mixed[3 * column + 2] = blue[column]
