"""Compiled loops from camera pixels to echoes, and over echoes; see `simnfnd.factory.compiled`.

The wrappers around them say what they compute, and the tests hold each against numpy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ..compiled import compiled
from ..elementary import FLOATS, atan2, cos

_F = np.float32
_ZERO = _F(0)
_OUT = "float32[::1]"

PICTURE = "Array(float32, 2, 'C', readonly=True)"
MASK = "Array(bool_, 2, 'C', readonly=True)"


@compiled()
def distance(range_m: Any, elevation_rad: Any, top_view: Any) -> Any:
    """Slant range, or its horizontal part, float32."""
    return range_m * cos(elevation_rad) if top_view else range_m


@compiled()
def cell(
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
) -> Any:
    """Flat index row * columns + column of an echo's cell; rows * columns for none.

    row = floor((distance - near_m) / span_m * rows); column = floor((azimuth - left) * per_rad).
    """
    away_m = distance(range_m, elevation_rad, top_view)
    row = np.int32(np.floor((away_m - near_m) / span_m * _F(rows)))
    column = np.int32(np.floor((azimuth_rad - left_rad) * per_rad))
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    return row * columns + column if inside else rows * columns


@compiled()
def nearest_beam(bin_: Any, azimuth_rad: Any, edges_rad: Any, columns: Any) -> Any:
    """The bin in the same row whose column is the number of edges at or below the azimuth."""
    return bin_ // columns * columns + np.searchsorted(edges_rad, azimuth_rad, side="right")


@compiled()
def _project(
    depth_m: Any,
    across: Any,
    down: Any,
    rotation: Any,
    position_m: Any,
    slant_m: Any,
    right_rad: Any,
    up_rad: Any,
) -> None:
    """A row of the picture: P = z K^-1 (u, v, 1)^T, seen from the sonar, in polar form."""
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    x0, y0, z0 = position_m[0], position_m[1], position_m[2]
    for column in range(len(depth_m)):
        z = depth_m[column]
        a, b, c = across[column] * z - x0, down * z - y0, z - z0
        forward = r00 * a + r01 * b + r02 * c
        left = r10 * a + r11 * b + r12 * c
        above = r20 * a + r21 * b + r22 * c
        ground2 = forward * forward + left * left
        slant_m[column] = np.sqrt(ground2 + above * above)
        right_rad[column] = atan2(-left, forward)
        up_rad[column] = atan2(above, np.sqrt(ground2))


@compiled(
    f"UniTuple(float64, 3)({PICTURE}, {PICTURE}, {MASK}, {FLOATS}, {FLOATS}, {PICTURE}, {FLOATS},"
    f"float32, float32, boolean, float32, float32, {_OUT})"
)
def survey(
    depth_m: Any,
    radiance: Any,
    surface: Any,
    across: Any,
    down: Any,
    rotation: Any,
    position_m: Any,
    half_hfov_rad: Any,
    half_vfov_rad: Any,
    top_view: Any,
    near_m: Any,
    far_m: Any,
    lit_m: Any,
) -> Any:
    """Put the distances of lit surface within limits and sector into `lit_m`.

    Returns their number and the smallest and largest azimuth within, lit or not.
    """
    height, width = depth_m.shape
    away, right, up = np.empty(width, _F), np.empty(width, _F), np.empty(width, _F)
    lit, least, most = np.uint64(0), _F(np.inf), _F(-np.inf)
    inside, kept = np.empty(width, np.bool_), np.empty(width, np.uint8)
    for row in range(height):
        _project(depth_m[row], across, down[row], rotation, position_m, away, right, up)
        for column in range(width):
            away[column] = distance(away[column], up[column], top_view)
        there, light = surface[row], radiance[row]
        for column in range(width):
            within = (
                there[column]
                & (away[column] >= near_m)
                & (away[column] < far_m)
                & (np.abs(right[column]) <= half_hfov_rad)
                & (np.abs(up[column]) <= half_vfov_rad)
            )
            inside[column], kept[column] = within, within & (light[column] > _ZERO)
        for column in range(width):
            azimuth = right[column]
            least = azimuth if inside[column] & (azimuth < least) else least
            most = azimuth if inside[column] & (azimuth > most) else most
        for column in range(width):
            # No branch: which pixels stay is not to be foreseen.
            lit_m[lit] = away[column]
            lit += np.uint64(kept[column])
    return float(lit), float(least), float(most)


@compiled(
    f"int64({PICTURE}, {PICTURE}, {MASK}, {FLOATS}, {FLOATS}, {PICTURE}, {FLOATS}, float32,"
    f"boolean, float32, float32, int64, float32, float32, int64, {FLOATS}, float64, {_OUT}, {_OUT},"
    f"{_OUT}, {_OUT}, int32[::1], boolean[::1])"
)
def insonified(
    depth_m: Any,
    radiance: Any,
    surface: Any,
    across: Any,
    down: Any,
    rotation: Any,
    position_m: Any,
    half_vfov_rad: Any,
    top_view: Any,
    near_m: Any,
    span_m: Any,
    rows: Any,
    left_rad: Any,
    per_rad: Any,
    columns: Any,
    edges_rad: Any,
    gain_power: Any,
    range_m: Any,
    azimuth_rad: Any,
    elevation_rad: Any,
    strength: Any,
    pixel: Any,
    hit: Any,
) -> Any:
    """Fill the last six with the lit surface that falls into a bin; returns how many there are.

    strength: radiance * range ** gain_power.  hit: set for the bins where an echo falls.
    """
    height, width = depth_m.shape
    nowhere = len(hit) - 1
    slant, right, up = np.empty(width, _F), np.empty(width, _F), np.empty(width, _F)
    level, bins = np.empty(width, _F), np.empty(width, np.int32)
    # Without a sign, as below: else every access asks whether it is negative.
    tabled, count = len(edges_rad) > 0, np.uint64(0)
    kept = np.empty(width, np.uint8)
    for row in range(height):
        _project(depth_m[row], across, down[row], rotation, position_m, slant, right, up)
        for column in range(width):
            bins[column] = cell(
                *(slant[column], right[column], up[column], top_view, near_m, span_m, rows),
                *(left_rad, per_rad, columns),
            )
        level[:] = radiance[row]
        if gain_power in (1.0, 2.0, 3.0, 4.0):
            for _ in range(int(gain_power)):
                for column in range(width):
                    level[column] *= slant[column]
        elif gain_power:
            for column in range(width):
                level[column] *= _F(float(slant[column]) ** gain_power)
        there, light = surface[row], radiance[row]
        for column in range(width):
            lit = (
                there[column]
                & (light[column] > _ZERO)
                & (np.abs(up[column]) <= half_vfov_rad)
                & (bins[column] != nowhere)
            )
            kept[column] = lit
            bins[column] = bins[column] if lit else nowhere
        if tabled:
            for column in range(width):
                if kept[column]:
                    bins[column] = nearest_beam(bins[column], right[column], edges_rad, columns)
        first = np.int32(row * width)
        for column in range(width):
            range_m[count] = slant[column]
            azimuth_rad[count] = right[column]
            elevation_rad[count] = up[column]
            strength[count] = level[column]
            pixel[count] = first + np.int32(column)
            hit[np.uint32(bins[column])] = True
            count += np.uint64(kept[column])
    hit[nowhere] = False
    return int(count)


@compiled(
    f"int64({FLOATS}, {FLOATS}, {FLOATS}, {FLOATS}, {FLOATS}, float32, {_OUT}, {_OUT}, {_OUT},"
    f"{_OUT})"
)
def thin(
    range_m: Any,
    azimuth_rad: Any,
    elevation_rad: Any,
    strength: Any,
    lot: Any,
    rate: Any,
    to_range_m: Any,
    to_azimuth_rad: Any,
    to_elevation_rad: Any,
    to_strength: Any,
) -> Any:
    """Copy the echoes whose `lot` is below `rate`; returns how many."""
    count = 0
    for at in range(len(range_m)):
        to_range_m[count] = range_m[at]
        to_azimuth_rad[count] = azimuth_rad[at]
        to_elevation_rad[count] = elevation_rad[at]
        to_strength[count] = strength[at]
        count += lot[at] < rate
    return count
