"""Compiled loops over the pixels of a view: surface colours, light and water, row by row.

Every pass over a row is one loop that the compiler does several pixels at a time.
Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled
from .field_loops import ROWS
from .light_loops import (
    net_of_light,
    roughen,
    shine_back,
    spread,
    through_water,
    weave,
)
from .texture_loops import look, look_close, place, seek

_F = np.float32
_ZERO, _ONE, _TWO, _THREE, _HALF = _F(0), _F(1), _F(2), _F(3), _F(0.5)
_DARKEST, _BRIGHTEST = _F(0.01), _F(0.95)
_TILE, _FINE_TILE = (f"Array(int32, {n}, 'C', readonly=True)" for n in (2, 3))
_PLANE, _VECTORS = "float32[:, ::1]", "float32[:, :, ::1]"


@compiled()
def ramp(low: Any, high: Any, x: Any) -> Any:
    """0 below `low`, 1 above `high`, smooth between; see `fields.smoothstep`."""
    t = min(max((x - low) / (high - low), _ZERO), _ONE)
    return t * t * (_THREE - _TWO * t)


@compiled()
def _ground(
    depth_m: Any,
    base: Any,
    found: Any,
    close_by: Any,
    palette: Any,
    turf: Any,
    albedo: Any,
    bump: Any,
) -> None:
    """Albedo (3, W) and bump (W,) of a row, as if all of it were ground.

    base: (3 W,) rockiness, gravel, relief.  found, close_by: (4, W), (6, W) of the noise tiles.
    """
    broads, grains, cellses, speckles = found[0], found[1], found[2], found[3]
    fine_broads, fine_grains, fine_cellses = close_by[0], close_by[1], close_by[2]
    fine_speckles = close_by[3]
    reds, greens, blues = albedo[0], albedo[1], albedo[2]
    sand_r, sand_g, sand_b = palette[0, 0], palette[0, 1], palette[0, 2]
    gravel_r, gravel_g, gravel_b = palette[1, 0], palette[1, 1], palette[1, 2]
    rock_r, rock_g, rock_b = palette[2, 0], palette[2, 1], palette[2, 2]
    algae_r, algae_g, algae_b = palette[3, 0], palette[3, 1], palette[3, 2]
    crust_r, crust_g, crust_b = palette[4, 0], palette[4, 1], palette[4, 2]
    bare, covered = _F(0.9) - _F(1.6) * turf, _F(1.7) - _F(1.6) * turf
    for column in range(len(depth_m)):
        broad, grain, cells, speckle = (
            broads[column],
            grains[column],
            cellses[column],
            speckles[column],
        )
        fine_broad, fine_grain = fine_broads[column], fine_grains[column]
        fine_cells, fine_speckle = fine_cellses[column], fine_speckles[column]
        # Detail that is finer than a pixel would only sparkle: fade it out with distance.
        close = min(max(_F(1.25) - depth_m[column] * _F(1 / 9), _ZERO), _ONE)
        tone = base[3 * column + 2]
        rock = ramp(_F(0.3), _F(0.7), base[3 * column] + _F(0.22) * grain * close + _F(0.1) * cells)
        gravel = ramp(_F(0.35), _F(0.65), base[3 * column + 1] + _F(0.18) * cells)
        sand_shade = (
            _ONE
            + _F(0.07) * broad
            + _F(0.07) * tone
            + close * (_F(0.06) * fine_grain + _F(0.05) * fine_speckle + _F(0.03) * speckle)
        )
        gravel_shade = _ONE + _F(0.10) * broad + _F(0.16) * tone
        gravel_shade += close * (_F(0.22) * fine_cells + _F(0.1) * speckle)
        grown = ramp(bare, covered, broad + _HALF * cells)
        crust = ramp(_F(0.9), _F(1.5), fine_broad + _F(0.4) * speckle)
        crust *= (_ONE - _F(0.6) * grown) * _F(0.7)
        rock_shade = _ONE + _F(0.14) * tone + _F(0.12) * grain
        rock_shade += close * (_F(0.14) * fine_cells + _F(0.12) * fine_grain)
        # Crevices are dark, edges are worn bright.
        rock_shade *= _F(0.75) + _HALF * ramp(_F(-2.0), _F(1.2), tone)
        stone = _stone(rock_r, algae_r, crust_r, grown, crust) * rock_shade
        loose = _loose(sand_r, gravel_r, sand_shade, gravel_shade, gravel)
        reds[column] = min(max(loose + rock * (stone - loose), _DARKEST), _BRIGHTEST)
        stone = _stone(rock_g, algae_g, crust_g, grown, crust) * rock_shade
        loose = _loose(sand_g, gravel_g, sand_shade, gravel_shade, gravel)
        greens[column] = min(max(loose + rock * (stone - loose), _DARKEST), _BRIGHTEST)
        stone = _stone(rock_b, algae_b, crust_b, grown, crust) * rock_shade
        loose = _loose(sand_b, gravel_b, sand_shade, gravel_shade, gravel)
        blues[column] = min(max(loose + rock * (stone - loose), _DARKEST), _BRIGHTEST)
        bump[column] = _F(0.10) + _F(0.35) * gravel + rock * (_HALF - _F(0.35) * gravel)


@compiled()
def _stone(bare: Any, algae: Any, growth: Any, grown: Any, crust: Any) -> Any:
    stone = bare + grown * (algae - bare)
    return stone + crust * (growth - stone)


@compiled()
def _loose(sand: Any, pebble: Any, sand_shade: Any, gravel_shade: Any, gravel: Any) -> Any:
    loose = sand * sand_shade
    return loose + gravel * (pebble * gravel_shade - loose)


@compiled()
def _objects(
    depth_m: Any,
    base: Any,
    normals: Any,
    owner: Any,
    finishes: Any,
    found: Any,
    close_by: Any,
    palette: Any,
    albedo: Any,
    bump: Any,
) -> None:
    """Albedo and bump of what of a row is an object; see `_ground` and `photograph`."""
    for column in range(len(depth_m)):
        number = owner[column]
        if number == 0:
            continue
        broad, grain, cells, speckle = (
            found[0, column],
            found[1, column],
            found[2, column],
            found[3, column],
        )
        fine_broad, fine_grain, fine_cells = (
            close_by[0, column],
            close_by[1, column],
            close_by[2, column],
        )
        close = min(max(_F(1.25) - depth_m[column] * _F(1 / 9), _ZERO), _ONE)
        fouling, silt = finishes[number - 1, 0], finishes[number - 1, 1]
        patchy = _F(0.6) * broad + _HALF * cells + _F(0.4) * fine_broad
        grown = ramp(_ZERO, _F(0.9), patchy + _F(2.2) * fouling - _F(1.3)) * _F(0.85)
        crust = ramp(_ONE, _F(1.5), fine_broad + _HALF * speckle)
        crust *= min(fouling * _F(1.5), _F(0.8))
        up = normals[3 * column + 2]
        dusted = ramp(_F(0.45), _F(0.95), up + _F(0.12) * grain + _F(0.1) * broad) * silt
        shade = _ONE + _F(0.10) * grain
        shade += close * (_F(0.10) * fine_grain + _F(0.10) * fine_cells)
        for k in range(3):
            tint = base[3 * column + k]
            tint += grown * (palette[3, k] - tint)
            tint = (tint + crust * (palette[4, k] - tint)) * shade
            sand = palette[0, k] * _F(0.8) * (_ONE + _F(0.07) * fine_grain)
            albedo[k, column] = min(max(tint + dusted * (sand - tint), _DARKEST), _BRIGHTEST)
        bump[column] = finishes[number - 1, 2] * _F(0.55) * (_ONE - _HALF * dusted)


@compiled(
    f"void({_PLANE}, {_VECTORS}, {_VECTORS}, uint16[:, ::1], {ROWS}, {ROWS}, float32, "
    f"float64[::1], float64[:, ::1], float64[::1], float32[::1], {_TILE}, {_FINE_TILE}, {ROWS}, "
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
    texture, fine, caustics, dither: see `fields`.  water: (6, 3) fade, growth and colour of the
    veil, sun, sky and lamp, see `Water`.  sun: (3,) its direction.  farthest_m: what is farther is
    water alone.  lit, free: every second pixel, see `surface_loops.light`.
    Written: colour (H, W, 3).
    """
    height, width = depth_m.shape
    side = texture.shape[0]
    last = side - 1  # of a power of two
    across = np.empty(width, np.float32)
    for column in range(width):
        across[column] = _F((column - lens[2]) / lens[0])
    points, near, glow = (
        np.empty((3, width), np.float32),
        np.empty(width, np.float32),
        np.empty(width, np.float32),
    )
    axis, at = np.empty(width, np.int32), np.empty((3, width), np.int32)
    words = np.empty((4, width), np.int32)
    part, found = np.empty((2, width), np.float32), np.empty((4, width), np.float32)
    close_by, albedo = np.empty((6, width), np.float32), np.empty((3, width), np.float32)
    bump, chance = np.empty(width, np.float32), np.empty(width, np.float32)
    shine, room = np.empty(width + 1, np.float32), np.empty(width + 1, np.float32)
    turned, seen = np.empty((3, width), np.float32), np.empty((3, width), np.float32)
    came = np.empty((3, width), np.float32)  # from the sun, from above, from the lamp
    has_lamp = water[5, 0] + water[5, 1] + water[5, 2] > 0
    came[2] = _ZERO
    rate = _ONE / caustic_period
    for row in range(height):
        # Flat, so that the compiler knows the steps from pixel to pixel.
        facing, what = normals[row].reshape(-1), base[row].reshape(-1)
        y0 = _F((row - lens[3]) / lens[1])
        for begin in range(0, width, side):
            for column in range(min(side, width - begin)):
                chance[begin + column] = dither[row & last, column]
        place(
            depth_m[row], facing, chance, across, y0, eye, axes, farthest_m,
            points, near, glow, axis,
        )  # fmt: skip
        seek(points, axis, offset, side, at, part)
        look(texture, at, part, words, found)
        look_close(fine, at[2], words, close_by)
        _ground(depth_m[row], what, found, close_by, palette, turf, albedo, bump)
        _objects(
            depth_m[row], what, facing, owner[row], finishes, found, close_by, palette, albedo, bump
        )  # fmt: skip
        spread(lit, row, shine)
        spread(free, row, room)
        roughen(depth_m[row], facing, close_by, axis, bump, near, shine, room, sun, turned, came)
        if caustic > 0:
            net_of_light(points, sun, caustic, rate, caustics, axis, bump, came[0])
        if has_lamp:
            shine_back(across, y0, axes, turned, near, room, came[2])
        through_water(albedo, came, near, glow, water, seen)
        weave(seen, colour[row].reshape(-1))
