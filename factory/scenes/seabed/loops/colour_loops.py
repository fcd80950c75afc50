"""Compiled loops over the pixels of a view: surface colours, light and water.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simnfnd.factory.compiled import compiled
from simnfnd.factory.scenes.seabed.fields import STEPS
from simnfnd.factory.scenes.seabed.loops.field_loops import ROWS

_F = np.float32
_ROUND = _F(12582912)
_STEP = _F(1 / STEPS)
_FINE = _F(0.8 / STEPS)  # looked up between four pixels, it would vary that much less
_LOG2E = _F(1 / np.log(2))
_E = tuple(_F(np.log(2) ** k / f) for k, f in enumerate((1, 1, 2, 6, 24, 120, 720)))
_ZERO, _ONE, _TWO, _THREE, _HALF = _F(0), _F(1), _F(2), _F(3), _F(0.5)
_TILE = "Array(int8, 3, 'C', readonly=True)"
_PLANE, _VECTORS = "float32[:, ::1]", "float32[:, :, ::1]"


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
def ramp(low: Any, high: Any, x: Any) -> Any:
    """0 below `low`, 1 above `high`, smooth between; see `fields.smoothstep`."""
    t = min(max((x - low) / (high - low), _ZERO), _ONE)
    return t * t * (_THREE - _TWO * t)


@compiled(
    f"void({_PLANE}, {_VECTORS}, {_VECTORS}, uint16[:, ::1], {ROWS}, {ROWS}, float32, "
    f"float64[::1], float64[:, ::1], float64[::1], float32[::1], {_TILE}, {_TILE}, {ROWS}, "
    f"{ROWS}, {ROWS}, float32[::1], float32, float32, float32, {_PLANE}, {_PLANE}, {_VECTORS})"
)
def photograph(
    depth_m: Any,
    normals: Any,
    base: Any,
    owner: Any,
    finishes: Any,
    palette: Any,
    turf: Any,
    eye: Any,
    axes: Any,
    lens: Any,
    offset: Any,
    texture: Any,
    fine: Any,
    caustics: Any,
    dither: Any,
    water: Any,
    sun: Any,
    caustic: Any,
    caustic_period: Any,
    farthest_m: Any,
    lit: Any,
    free: Any,
    colour: Any,
) -> None:
    """Linear colour that reaches the camera.

    depth_m, normals, base, owner: what the pixels meet (`surface_loops.meet`).  finishes: (N, 3)
    fouling, silt and bump of each object.  palette: (5, 3) sand, gravel, rock, algae, crust.
    water: (6, 3) fade, growth and colour of the veil, sun, sky and lamp, see `Water`.
    sun: (3,) its direction.  lit, free: every second pixel, see `surface_loops.light`.
    Written: colour (H, W, 3).
    """
    height, width = depth_m.shape
    has_lamp = water[5, 0] + water[5, 1] + water[5, 2] > 0
    albedo = np.empty((3, width), np.float32)
    from_sun, from_above = np.empty(width, np.float32), np.empty(width, np.float32)
    from_lamp, near, glow = (
        np.empty(width, np.float32),
        np.empty(width, np.float32),
        np.empty(width, np.float32),
    )
    half_rows, half_columns = lit.shape
    side = texture.shape[0]
    fine_side = fine.shape[0]
    last = side - 1  # of a power of two
    found = np.empty(4, np.float32)
    caustic_rate = _ONE / caustic_period
    for row in range(height):
        y0 = _F((row - lens[3]) / lens[1])
        upper = min(row >> 1, half_rows - 1)
        lower = min(upper + (row & 1), half_rows - 1)
        for column in range(width):
            x0 = _F((column - lens[2]) / lens[0])
            toward_x = _F(axes[0, 0]) * x0 + _F(axes[0, 1]) * y0 + _F(axes[0, 2])
            toward_y = _F(axes[1, 0]) * x0 + _F(axes[1, 1]) * y0 + _F(axes[1, 2])
            toward_z = _F(axes[2, 0]) * x0 + _F(axes[2, 1]) * y0 + _F(axes[2, 2])
            length = np.sqrt(_ONE + x0 * x0 + y0 * y0)
            depth = depth_m[row, column]
            lift = min(max(toward_z / length + _F(0.35), _ZERO), _ONE)
            glow[column] = _F(0.72) + _F(0.9) * lift * lift
            range_m = depth * length
            if not range_m < farthest_m:
                near[column] = _F(200)
                from_sun[column] = from_above[column] = from_lamp[column] = _ZERO
                albedo[0, column] = albedo[1, column] = albedo[2, column] = _ZERO
                continue
            near[column] = min(range_m, _F(200))
            x = _F(eye[0]) + depth * toward_x
            y = _F(eye[1]) + depth * toward_y
            z = _F(eye[2]) + depth * toward_z
            nx, ny, nz = (
                normals[row, column, 0],
                normals[row, column, 1],
                normals[row, column, 2],
            )
            # The tile is laid on from one axis, by chance in proportion to the normal.
            sx, sy, sz = nx * nx, ny * ny, nz * nz
            sx, sy, sz = sx * sx, sy * sy, sz * sz
            chance = dither[row & (side - 1), column & (side - 1)] * (sx + sy + sz)
            axis = 0 if chance < sx else 1 if chance < sx + sy else 2
            u = (y if axis == 0 else x) + offset[0]
            v = (y if axis == 2 else z) + offset[1]
            # Detail that is finer than a pixel would only sparkle: fade it out with distance.
            close = min(max(_F(1.25) - depth * _F(1 / 9), _ZERO), _ONE)
            at_x, at_y = u * _F(1 / 3.7), v * _F(1 / 3.7)
            at_x, at_y = (at_x - np.floor(at_x)) * _F(side), (at_y - np.floor(at_y)) * _F(side)
            left, top = int(at_x), int(at_y)
            right, down = at_x - _F(left), at_y - _F(top)
            left, top = left & last, top & last
            beside, below = (left + 1) & last, (top + 1) & last
            for k in range(4):
                upper_value = _F(texture[top, left, k])
                upper_value += right * (_F(texture[top, beside, k]) - upper_value)
                lower_value = _F(texture[below, left, k])
                lower_value += right * (_F(texture[below, beside, k]) - lower_value)
                found[k] = (upper_value + down * (lower_value - upper_value)) * _STEP
            broad, grain, cells, speckle = found[0], found[1], found[2], found[3]
            # What follows is finer than the picture: one pixel of the tile will do.
            at_x, at_y = u * _F(1 / 0.7), v * _F(1 / 0.7)
            at_x = int((at_x - np.floor(at_x)) * _F(fine_side)) & (fine_side - 1)
            at_y = int((at_y - np.floor(at_y)) * _F(fine_side)) & (fine_side - 1)
            fine_broad = _F(fine[at_y, at_x, 0]) * _FINE
            fine_grain = _F(fine[at_y, at_x, 1]) * _FINE
            fine_cells = _F(fine[at_y, at_x, 2]) * _FINE
            fine_speckle = _F(fine[at_y, at_x, 3]) * _FINE
            along_u, along_v = _F(fine[at_y, at_x, 4]) * _FINE, _F(fine[at_y, at_x, 5]) * _FINE
            number = owner[row, column]
            if number == 0:
                tone = base[row, column, 2]
                rock = ramp(
                    _F(0.3), _F(0.7),
                    base[row, column, 0] + _F(0.22) * grain * close + _F(0.1) * cells,
                )  # fmt: skip
                gravel = ramp(_F(0.35), _F(0.65), base[row, column, 1] + _F(0.18) * cells)
                sand_shade = (
                    _ONE
                    + _F(0.07) * broad
                    + _F(0.07) * tone
                    + close * (_F(0.06) * fine_grain + _F(0.05) * fine_speckle + _F(0.03) * speckle)
                )
                gravel_shade = _ONE + _F(0.10) * broad + _F(0.16) * tone
                gravel_shade += close * (_F(0.22) * fine_cells + _F(0.1) * speckle)
                grown, crust, rock_shade = _ZERO, _ZERO, _ONE
                if rock > 0:
                    grown = ramp(
                        _F(0.9) - _F(1.6) * turf, _F(1.7) - _F(1.6) * turf, broad + _HALF * cells
                    )
                    crust = ramp(_F(0.9), _F(1.5), fine_broad + _F(0.4) * speckle)
                    crust *= (_ONE - _F(0.6) * grown) * _F(0.7)
                    rock_shade = _ONE + _F(0.14) * tone + _F(0.12) * grain
                    rock_shade += close * (_F(0.14) * fine_cells + _F(0.12) * fine_grain)
                    # Crevices are dark, edges are worn bright.
                    rock_shade *= _F(0.75) + _HALF * ramp(_F(-2.0), _F(1.2), tone)
                for k in range(3):
                    stone = palette[2, k] + grown * (palette[3, k] - palette[2, k])
                    stone += crust * (palette[4, k] - stone)
                    loose = palette[0, k] * sand_shade
                    loose += gravel * (palette[1, k] * gravel_shade - loose)
                    value = loose + rock * (stone * rock_shade - loose)
                    albedo[k, column] = min(max(value, _F(0.01)), _F(0.95))
                bump = _F(0.10) + _F(0.35) * gravel + rock * (_HALF - _F(0.35) * gravel)
            else:
                fouling, silt = finishes[number - 1, 0], finishes[number - 1, 1]
                patchy = _F(0.6) * broad + _HALF * cells + _F(0.4) * fine_broad
                grown = ramp(_ZERO, _F(0.9), patchy + _F(2.2) * fouling - _F(1.3)) * _F(0.85)
                crust = ramp(_ONE, _F(1.5), fine_broad + _HALF * speckle)
                crust *= min(fouling * _F(1.5), _F(0.8))
                dusted = ramp(_F(0.45), _F(0.95), nz + _F(0.12) * grain + _F(0.1) * broad) * silt
                shade = _ONE + _F(0.10) * grain
                shade += close * (_F(0.10) * fine_grain + _F(0.10) * fine_cells)
                for k in range(3):
                    tint = base[row, column, k]
                    tint += grown * (palette[3, k] - tint)
                    tint = (tint + crust * (palette[4, k] - tint)) * shade
                    sand = palette[0, k] * _F(0.8) * (_ONE + _F(0.07) * fine_grain)
                    value = tint + dusted * (sand - tint)
                    albedo[k, column] = min(max(value, _F(0.01)), _F(0.95))
                bump = finishes[number - 1, 2] * _F(0.55) * (_ONE - _HALF * dusted)
            # Tilt the normal against the gradient of a rough surface.
            bump *= _F(0.25) + _F(0.75) * close
            gx = _ZERO if axis == 0 else along_u
            gy = along_u if axis == 0 else _ZERO if axis == 1 else along_v
            gz = _ZERO if axis == 2 else along_v
            along = gx * nx + gy * ny + gz * nz
            nx -= bump * (gx - along * nx)
            ny -= bump * (gy - along * ny)
            nz -= bump * (gz - along * nz)
            unit = _ONE / max(np.sqrt(nx * nx + ny * ny + nz * nz), _F(1e-6))
            nx, ny, nz = nx * unit, ny * unit, nz * unit
            left = min(column >> 1, half_columns - 1)
            beside = min(left + (column & 1), half_columns - 1)
            shine = lit[upper, left] + lit[upper, beside] + lit[lower, left] + lit[lower, beside]
            room = free[upper, left] + free[upper, beside] + free[lower, left] + free[lower, beside]
            shine, room = shine * _F(0.25), room * _F(0.25)
            bright = max(nx * sun[0] + ny * sun[1] + nz * sun[2], _ZERO) * shine
            if caustic > 0 and bright > 0:
                # Nets of light that follow the sun's rays down.
                net_x = (x - z * (sun[0] / sun[2])) * caustic_rate
                net_y = (y - z * (sun[1] / sun[2])) * caustic_rate
                left = int((net_x - np.floor(net_x)) * _F(side)) & last
                top = int((net_y - np.floor(net_y)) * _F(side)) & last
                net = caustics[top, left]  # the pixels of this tile are finer than the light's
                bright *= _ONE + caustic * (net - _ONE)
            from_sun[column] = bright
            from_above[column] = room * (_F(0.55) + _F(0.45) * nz)
            from_lamp[column] = _ZERO
            if has_lamp:
                facing = -(nx * toward_x + ny * toward_y + nz * toward_z) / length
                # The beam is bright in the middle of the picture.
                beam = exponential(max((_ONE - length) * _F(1 / 0.11), _F(-30)))
                spread = max(near[column], _HALF)
                from_lamp[column] = (
                    max(facing, _ZERO) * (_F(0.4) + _F(0.6) * room) * beam / (spread * spread)
                )
        for k in range(3):
            fades, grows, veil = -water[0, k], -water[1, k], water[2, k]
            sunny, sky, lamp = water[3, k], water[4, k], water[5, k]
            for column in range(width):
                fade = exponential(max(fades * near[column], _F(-30)))
                haze = _ONE - exponential(max(grows * near[column], _F(-30)))
                # The lamp's light fades on its way out as well as back.
                coming = sunny * from_sun[column] + sky * from_above[column]
                coming += lamp * from_lamp[column] * fade
                colour[row, column, k] = (
                    albedo[k, column] * coming * fade + veil * haze * glow[column]
                )
