"""Compiled loops from camera pixels to echoes and from echoes to images.

The functions that call them say what they compute, and the tests hold each against numpy or scipy.
Imported where they are used: see `simnfnd.factory.common.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...common.compiled import compiled
from ...common.elementary import FLOATS, atan2, cos, rotated, rotation_numbers

_F = np.float32
_ZERO = _F(0)
_OUT = "float32[::1]"
_IMAGE = "Array(float32, 2, 'C', readonly=True)"
_MASK = "Array(bool_, 2, 'C', readonly=True)"
_PLACES = "Array(int32, 1, 'C', readonly=True)"
# Depth, radiance and surface of the pixels (H, W); x / z of the columns, y / z of the rows; sonar
# axes from camera axes, and where the sonar is in these.
_PIXELS = f"Tuple(({_IMAGE}, {_IMAGE}, {_MASK}, {FLOATS}, {FLOATS}, {_IMAGE}, {FLOATS}))"
# Whether ranges are those of a view from above; near_m, span_m, rows; left_rad, per_rad, columns.
_GRID = "Tuple((boolean, float32, float32, int64, float32, float32, int64))"


@compiled()
def _distance(range_m: Any, elevation_rad: Any, top_view: Any) -> Any:
    """Slant range, or its horizontal part, float32."""
    return range_m * cos(elevation_rad) if top_view else range_m


@compiled()
def _cell(range_m: Any, azimuth_rad: Any, elevation_rad: Any, grid: Any) -> Any:
    """Flat index row * columns + column of an echo's cell; rows * columns for none.

    row = floor((distance - near_m) / span_m * rows); column = floor((azimuth - left) * per_rad).
    """
    top_view, near_m, span_m, rows, left_rad, per_rad, columns = grid
    away_m = _distance(range_m, elevation_rad, top_view)
    row = np.int32(np.floor((away_m - near_m) / span_m * _F(rows)))
    column = np.int32(np.floor((azimuth_rad - left_rad) * per_rad))
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    return row * columns + column if inside else rows * columns


@compiled()
def _nearest_beam(bin_: Any, azimuth_rad: Any, edges_rad: Any, columns: Any) -> Any:
    """The bin in the same row whose column is the number of edges at or below the azimuth."""
    return bin_ // columns * columns + np.searchsorted(edges_rad, azimuth_rad, side="right")


@compiled()
def _project(pixels: Any, row: Any, slant_m: Any, right_rad: Any, up_rad: Any) -> None:
    """Put slant range, azimuth and elevation of a row of pixels into the last three, (W,) each.

    A pixel's point is P = z K^-1 (u, v, 1)^T in camera axes; these are its coordinates seen from
    the sonar.  pixels: see `_PIXELS`.
    """
    depths_m, _, _, across, downs, rotation, position_m = pixels
    depth_m = depths_m[row]
    down = downs[row]
    turn = rotation_numbers(rotation)
    x0 = position_m[0]
    y0 = position_m[1]
    z0 = position_m[2]
    for column in range(len(depth_m)):
        z = depth_m[column]
        a = across[column] * z - x0
        b = down * z - y0
        c = z - z0
        forward, left, above = rotated(turn, a, b, c)
        ground_squared = forward * forward + left * left
        slant_m[column] = np.sqrt(ground_squared + above * above)
        right_rad[column] = atan2(-left, forward)
        up_rad[column] = atan2(above, np.sqrt(ground_squared))


@compiled(f"UniTuple(float64, 3)({_PIXELS}, float32, float32, boolean, float32, float32, {_OUT})")
def list_lit_distances(
    pixels: Any, half_hfov_rad: Any, half_vfov_rad: Any, top_view: Any, near_m: Any, far_m: Any,
    lit_m: Any,
) -> Any:  # fmt: skip
    """Put the distances of lit surface within limits and sector into `lit_m`.

    Returns their number and the smallest and largest azimuth within, lit or not.
    """
    radiance = pixels[1]
    surface = pixels[2]
    height, width = surface.shape
    away = np.empty(width, _F)
    right = np.empty(width, _F)
    up = np.empty(width, _F)
    lit = np.uint64(0)
    least = _F(np.inf)
    most = _F(-np.inf)
    inside = np.empty(width, np.bool_)
    is_lit = np.empty(width, np.uint8)
    for row in range(height):
        _project(pixels, row, away, right, up)
        for column in range(width):
            away[column] = _distance(away[column], up[column], top_view)
        is_surface = surface[row]
        light = radiance[row]
        for column in range(width):
            within = (
                is_surface[column]
                & (away[column] >= near_m)
                & (away[column] < far_m)
                & (np.abs(right[column]) <= half_hfov_rad)
                & (np.abs(up[column]) <= half_vfov_rad)
            )
            inside[column] = within
            is_lit[column] = within & (light[column] > _ZERO)
        for column in range(width):
            azimuth = right[column]
            least = azimuth if inside[column] & (azimuth < least) else least
            most = azimuth if inside[column] & (azimuth > most) else most
        for column in range(width):
            # No branch: which pixels stay is not to be foreseen.
            lit_m[lit] = away[column]
            lit += np.uint64(is_lit[column])
    return float(lit), float(least), float(most)


@compiled(
    f"int64({_PIXELS}, float32, {_GRID}, {FLOATS}, float64, UniTuple({_OUT}, 4), int32[::1],"
    " boolean[::1])"
)
def insonified(
    pixels: Any, half_vfov_rad: Any, grid: Any, edges_rad: Any, gain_power: Any, echoes: Any,
    pixel: Any, hit: Any,
) -> Any:  # fmt: skip
    """Fill the last three with the lit surface that falls into a bin; returns how many there are.

    echoes: range, azimuth, elevation, strength = radiance * range ** gain_power.  hit: set for the
    bins where an echo falls.
    """
    range_m, azimuth_rad, elevation_rad, strength = echoes
    columns = grid[6]
    radiance = pixels[1]
    surface = pixels[2]
    height, width = surface.shape
    nowhere = len(hit) - 1
    slant = np.empty(width, _F)
    right = np.empty(width, _F)
    up = np.empty(width, _F)
    level = np.empty(width, _F)
    bins = np.empty(width, np.int32)
    # Without a sign, as below: else every access asks whether it is negative.
    tabled = len(edges_rad) > 0
    count = np.uint64(0)
    is_lit = np.empty(width, np.uint8)
    for row in range(height):
        _project(pixels, row, slant, right, up)
        for column in range(width):
            bins[column] = _cell(slant[column], right[column], up[column], grid)
        level[:] = radiance[row]
        if gain_power in (1.0, 2.0, 3.0, 4.0):
            for _ in range(int(gain_power)):
                for column in range(width):
                    level[column] *= slant[column]
        elif gain_power:
            for column in range(width):
                level[column] *= _F(float(slant[column]) ** gain_power)
        is_surface = surface[row]
        light = radiance[row]
        for column in range(width):
            lit = (
                is_surface[column]
                & (light[column] > _ZERO)
                & (np.abs(up[column]) <= half_vfov_rad)
                & (bins[column] != nowhere)
            )
            is_lit[column] = lit
            bins[column] = bins[column] if lit else nowhere
        if tabled:
            for column in range(width):
                if is_lit[column]:
                    bins[column] = _nearest_beam(bins[column], right[column], edges_rad, columns)
        first = np.int32(row * width)
        for column in range(width):
            range_m[count] = slant[column]
            azimuth_rad[count] = right[column]
            elevation_rad[count] = up[column]
            strength[count] = level[column]
            pixel[count] = first + np.int32(column)
            hit[np.uint32(bins[column])] = True
            count += np.uint64(is_lit[column])
    hit[nowhere] = False
    return int(count)


@compiled(f"int64(UniTuple({FLOATS}, 4), {FLOATS}, float32, UniTuple({_OUT}, 4))")
def thin(echoes: Any, chance: Any, rate: Any, subset: Any) -> Any:
    """Copy the echoes whose `chance` is below `rate`; returns how many."""
    range_m, azimuth_rad, elevation_rad, strength = echoes
    to_range_m, to_azimuth_rad, to_elevation_rad, to_strength = subset
    count = 0
    for at in range(len(range_m)):
        to_range_m[count] = range_m[at]
        to_azimuth_rad[count] = azimuth_rad[at]
        to_elevation_rad[count] = elevation_rad[at]
        to_strength[count] = strength[at]
        count += chance[at] < rate
    return count


@compiled(f"void(UniTuple({FLOATS}, 3), {_GRID}, {FLOATS}, int32[::1])")
def bin_of_each(coordinates: Any, grid: Any, edges_rad: Any, bins: Any) -> None:
    """Put the flat cell of each echo into `bins`; rows * columns outside the grid.

    coordinates: range, azimuth and elevation, (N,) each.  grid: see `polar.EvenGrid`.
    edges_rad: azimuths between tabled beams, which replace the grid's even columns; (0,): none.
    """
    range_m, azimuth_rad, elevation_rad = coordinates
    _, _, _, rows, _, _, columns = grid
    outside = rows * columns
    for echo in range(len(bins)):
        bins[echo] = _cell(range_m[echo], azimuth_rad[echo], elevation_rad[echo], grid)

    if len(edges_rad) == 0:
        return
    for echo in range(len(bins)):
        if bins[echo] != outside:
            bins[echo] = _nearest_beam(bins[echo], azimuth_rad[echo], edges_rad, columns)


@compiled(f"void(int32[::1], {FLOATS}, boolean, {_OUT})")
def gather(bins: Any, strength: Any, loudest: Any, level: Any) -> None:
    """Add the echoes, or keep the loudest, in `level`; its last cell is for those without a bin."""
    if loudest:
        for at in range(len(bins)):
            level[bins[at]] = max(level[bins[at]], strength[at])
    else:
        for at in range(len(bins)):
            level[bins[at]] += strength[at]


@compiled()
def _add(values: Any, weight: Any, total: Any) -> None:
    # Slices from 0 on: the compiler then knows that no index is negative.
    for at in range(len(total)):
        total[at] += weight * values[at]


@compiled(f"void({_IMAGE}, {FLOATS}, {FLOATS}, float32[:, ::1])")
def blur(level: Any, down: Any, across: Any, blurred: Any) -> None:
    """Correlate with two odd kernels, along rows and columns; nothing lies outside."""
    rows, columns = level.shape
    reach = len(down) // 2
    side = len(across) // 2
    wide = np.zeros(columns + 2 * side, _F)
    line = wide[side : side + columns]
    for row in range(rows):
        line[:] = _ZERO
        for step in range(max(-reach, -row), min(reach, rows - 1 - row) + 1):
            _add(level[row + step], down[step + reach], line)
        blurred[row] = _ZERO
        for step in range(len(across)):
            _add(wide[step : step + columns], across[step], blurred[row])


@compiled(f"void({_IMAGE}, {_PLACES}, {_PLACES}, {FLOATS}, {FLOATS}, {_OUT})")
def bilinear(polar: Any, pixel: Any, corner: Any, down: Any, across: Any, fan: Any) -> None:
    """fan[pixel] = the four bins from `corner` on, mixed by the fractions down and across."""
    flat = polar.ravel()
    columns = polar.shape[1]
    unit = _F(1)
    for at in range(len(pixel)):
        bin_ = corner[at]
        u = down[at]
        v = across[at]
        near = flat[bin_] * (unit - v) + flat[bin_ + 1] * v
        far = flat[bin_ + columns] * (unit - v) + flat[bin_ + columns + 1] * v
        fan[pixel[at]] = near * (unit - u) + far * u
