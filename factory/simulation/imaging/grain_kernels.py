"""Compiled loops that find the scattering points of a frame's surfaces.

The world is covered by cells, each of which holds one point at a place that its name decides.  Four
neighbouring camera pixels are the corners of a quad, and neighbouring quads share their edges, so a
point lies in one quad whatever the camera's pixels are, and is found without a table.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...common.array_types import Bools, Float32s
from ...common.compiled import compiled
from .kernels import (
    _CAMERA,
    _GOLDEN,
    _GRID,
    _MATRIX,
    _ONE,
    _STEPS_X,
    _STEPS_Y,
    _ZERO,
    _16,
    _beam_at,
    mixed,
)

# Where a point lies in its cell: 16 bits of its name for either axis.
_PLACE_STEP = 1.0 / 65536.0
_LOWER_BITS = np.uint32(0xFFFF)
# Keep names apart: by layers across the faced plane, levels of cells, and bodies.
_LAYER_SALT = np.uint32(0x9E3779B1)
_LEVEL_SALT = np.uint32(0x7FEB352D)
# A layer is so many cells thick; where it begins differs from cell to cell.
_LAYERS_PER_CELL = 1.0 / 16.0
# Heights that a phase tells apart: a surface that is known to a cell rarely crosses from one to the
# next, and a direction that is off by four cells changes no phase on a way of centimetres.
_HEIGHTS_PER_CELL = 0.25
# A pixel is one surface with its right neighbour up to this step, a part of the depth.
_STEP_TOGETHER = np.float32(0.05)
# At most so many pixels of a row are one quad: those from one multiple of it to the next.
_MOST_PIXELS = 4

# Of moving objects: flat pixels (ascending), bodies, places in their own axes, salts of the bodies.
_MOVING = "Tuple((int32[::1], int32[::1], float64[:, ::1], uint32[::1]))"
# Points, (room,) each: bins, powers, names, phases.
_POINTS = "Tuple((int32[::1], float32[::1], uint32[::1], uint16[::1]))"


@compiled()
def _place_row(row: Any, camera: Any, axes: Any, moving: Any, places: Any, bodies: Any) -> None:
    """Where the pixels of a camera row lie, and on which body.

    places: (6, W) out, home axes (the world's; a moving object's own), then sonar axes.
    bodies: (W,) out, 0 for the static scene.
    """
    depth_m, across, down = camera
    home, sonar = axes
    width = depth_m.shape[1]
    z_of = depth_m[row]
    downward = np.float64(down[row])
    h00, h01, h02, h03 = home[0]
    h10, h11, h12, h13 = home[1]
    h20, h21, h22, h23 = home[2]
    s00, s01, s02, s03 = sonar[0]
    s10, s11, s12, s13 = sonar[1]
    s20, s21, s22, s23 = sonar[2]
    home_x, home_y, home_z, ahead, left, up = places
    for column in range(width):
        z = np.float64(z_of[column])
        x = np.float64(across[column]) * z
        y = downward * z
        home_x[column] = h00 * x + h01 * y + h02 * z + h03
        home_y[column] = h10 * x + h11 * y + h12 * z + h13
        home_z[column] = h20 * x + h21 * y + h22 * z + h23
        ahead[column] = s00 * x + s01 * y + s02 * z + s03
        left[column] = s10 * x + s11 * y + s12 * z + s13
        up[column] = s20 * x + s21 * y + s22 * z + s23
        bodies[column] = 0
    pixels, body_of, own_m, _ = moving
    number = np.searchsorted(pixels, row * width)
    while number < pixels.shape[0] and pixels[number] < (row + 1) * width:
        column = pixels[number] - row * width
        home_x[column], home_y[column], home_z[column] = own_m[number]
        bodies[column] = body_of[number] + 1
        number += 1


@compiled()
def _at(places: Any, column: Any) -> Any:
    return (
        places[0, column], places[1, column], places[2, column],
        places[3, column], places[4, column], places[5, column],
    )  # fmt: skip


@compiled()
def _difference(end: Any, start: Any) -> Any:
    return (
        end[0] - start[0], end[1] - start[1], end[2] - start[2],
        end[3] - start[3], end[4] - start[4], end[5] - start[5],
    )  # fmt: skip


@compiled()
def _sum(first: Any, second: Any) -> Any:
    return (
        first[0] + second[0], first[1] + second[1], first[2] + second[2],
        first[3] + second[3], first[4] + second[4], first[5] + second[5],
    )  # fmt: skip


@compiled()
def _pixel_step(step_m: Any, axis: Any, axes: Any) -> Any:
    """The way of one pixel along a camera axis, where no neighbour continues the surface."""
    home, sonar = axes
    return (
        step_m * home[0, axis], step_m * home[1, axis], step_m * home[2, axis],
        step_m * sonar[0, axis], step_m * sonar[1, axis], step_m * sonar[2, axis],
    )  # fmt: skip


@compiled()
def _faced_axis(right: Any, down: Any, across: Any) -> Any:
    """The home axis that a quad faces most, and its area as seen along that axis.

    right, down, across: the ways from its first corner to the others.
    """
    # Half the product of the diagonals.
    g0, g1, g2, _, _, _ = across
    h0 = down[0] - right[0]
    h1 = down[1] - right[1]
    h2 = down[2] - right[2]
    n0 = 0.5 * abs(g1 * h2 - g2 * h1)
    n1 = 0.5 * abs(g2 * h0 - g0 * h2)
    n2 = 0.5 * abs(g0 * h1 - g1 * h0)
    if n2 >= n0 and n2 >= n1:
        return 2, n2
    if n0 >= n1:
        return 0, n0
    return 1, n1


@compiled()
def _in_plane(way: Any, axis: Any, per_m: Any) -> Any:
    """The two coordinates across an axis, and the one along it, in cells."""
    if axis == 2:
        return way[0] * per_m, way[1] * per_m, way[2] * per_m
    if axis == 0:
        return way[1] * per_m, way[2] * per_m, way[0] * per_m
    return way[2] * per_m, way[0] * per_m, way[1] * per_m


@compiled()
def _inverse(first_a: Any, first_b: Any, second_a: Any, second_b: Any) -> Any:
    """Four numbers that give the shares u, v of points (a, b) = u first + v second.

    They are infinite or NaN where the two ways are one: no point then lies in their triangle.
    """
    per_area = 1.0 / (first_a * second_b - first_b * second_a)
    return second_b * per_area, -second_a * per_area, -first_b * per_area, first_a * per_area


@compiled()
def _off_the_plane(right: Any, down: Any, axis: Any) -> Any:
    """One metre along a home axis, in sonar axes, for a quad that both axes know the edges of.

    A body may have turned and bent: its edges r and d and their product n in home axes have images
    in sonar axes, and any way is a sum of the three.
    """
    r0, r1, r2, r3, r4, r5 = right
    d0, d1, d2, d3, d4, d5 = down
    n0 = r1 * d2 - r2 * d1
    n1 = r2 * d0 - r0 * d2
    n2 = r0 * d1 - r1 * d0
    square = n0 * n0 + n1 * n1 + n2 * n2
    if axis == 2:
        of_right = d0 * n1 - d1 * n0
        of_down = n0 * r1 - n1 * r0
        of_normal = n2
    elif axis == 0:
        of_right = d1 * n2 - d2 * n1
        of_down = n1 * r2 - n2 * r1
        of_normal = n0
    else:
        of_right = d2 * n0 - d0 * n2
        of_down = n2 * r0 - n0 * r2
        of_normal = n1
    of_right /= square
    of_down /= square
    of_normal /= square
    return (
        of_right * r3 + of_down * d3 + of_normal * (r4 * d5 - r5 * d4),
        of_right * r4 + of_down * d4 + of_normal * (r5 * d3 - r3 * d5),
        of_right * r5 + of_down * d5 + of_normal * (r3 * d4 - r4 * d3),
    )


@compiled()
def _bin_of(ahead: Any, left: Any, up: Any, grid: Any, beam_table: Any) -> Any:
    """Range bin, how far into it, and beam of a place in sonar axes; bin -1 outside the window."""
    ground_range, near_m, bins_per_m, rows, edges, _, _ = grid
    nowhere = (-1, _ZERO, 0)
    if ahead <= 0:
        return nowhere
    ground_square = ahead * ahead + left * left
    range_m = np.sqrt(ground_square + up * up)
    bearing = np.float32(-left / range_m)
    if not (edges[0] <= bearing and bearing < edges[edges.shape[0] - 1]):
        return nowhere
    distance_m = np.sqrt(ground_square) if ground_range else range_m
    place = (distance_m - near_m) * bins_per_m
    row = int(np.floor(place))
    if row < 0 or row >= rows:
        return nowhere
    return row, np.float32(place - row), _beam_at(bearing, edges[0], beam_table)


@compiled()
def _add_point(count: Any, at: Any, weight: Any, name: Any, phase: Any, out: Any) -> Any:
    """Write a point of a bin that echoes; returns how many points there are now."""
    power, total, _, (bins, weights, names, phases) = out
    if not power[at] > _ZERO:
        return count
    total[at] += weight
    if count < bins.shape[0]:
        bins[count] = at
        weights[count] = weight
        names[count] = name
        phases[count] = phase
    return count + 1


@compiled()
def _add_to_bins(count: Any, place: Any, weight: Any, name: Any, phase: Any, out: Any) -> Any:
    """Write a point; near the edge of a range bin it lies in both, in parts of its power.

    place: range bin, how far into it, beam, and how many beams there are.
    """
    row, into, beam, beams = place
    power, _, edge_bins, _ = out
    at = row * beams + beam
    beyond = into - (_ONE - edge_bins)
    before = edge_bins - into
    nearest = max(beyond, before)
    neighbour = at + beams if beyond > before else at - beams
    if nearest > _ZERO and 0 <= neighbour < power.shape[0] and power[neighbour] > _ZERO:
        part = weight * nearest / (edge_bins + edge_bins)
        count = _add_point(count, neighbour, part, name, phase, out)
        weight = weight - part
    return _add_point(count, at, weight, name, phase, out)


@compiled(
    f"int64({_CAMERA}, {_MATRIX}, boolean[:, ::1], UniTuple(float64[:, ::1], 2), {_MOVING},"
    f" {_GRID}, UniTuple(float64[::1], 2), float64,"
    f" Tuple((float32[::1], float32[::1], float32, {_POINTS})))"
)
def strew(
    camera: Any, echoes: Float32s, joins_below: Bools, axes: Any, moving: Any, grid: Any,
    levels: Any, turns_per_m: float, out: Any,
) -> int:  # fmt: skip
    """One point in each cell of the surfaces that echo; returns how many there are.

    A cell is a square in the plane of the two home axes that a surface faces most.
    echoes: (H, W) power of each pixel, 0 where nothing echoes.  joins_below: (H, W), whether the
    pixel below shows the same surface.
    axes: (3, 4) world from camera, (3, 4) sonar from camera.
    levels: edges of cells (L,), metres, and squares of the ranges between which each is used
    (L + 1,).
    turns_per_m: of the phase, per metre of range; 0: no phases.
    out: (bins,) power of each bin; (bins,) zeros, sums of the weights of its points; how near
    to the edge of a range bin a point lies in both, in bins; the points,
    with room for twice as many as there are cells.  Without enough room they are only counted.
    """
    depth_m, across, down = camera
    height, width = depth_m.shape
    edges_m, square_of = levels
    salts = moving[3]
    edges = grid[4]
    beams = edges.shape[0] - 1
    beam_table = (edges, grid[5], np.float32(grid[6]), np.float32(grid[5].shape[0] - 1))
    last_level = edges_m.shape[0] - 1
    places = np.empty((6, width))
    places_below = np.empty((6, width))
    bodies = np.empty(width, np.int32)
    bodies_below = np.empty(width, np.int32)
    _place_row(0, camera, axes, moving, places_below, bodies_below)
    level = 0
    count = 0
    for row in range(height):
        places, places_below = places_below, places
        bodies, bodies_below = bodies_below, bodies
        under = min(row + 1, height - 1)
        _place_row(under, camera, axes, moving, places_below, bodies_below)
        side = 0
        while side < width:
            column = side
            power = echoes[row, column]
            side += 1
            if not power > _ZERO:
                continue

            # The quad between this pixel, one on its right, and those below.
            z = depth_m[row, column]
            z_below = depth_m[under, column]
            most = _STEP_TOGETHER * z
            body = bodies[column]
            goes_down = joins_below[row, column] and bodies_below[column] == body and under > row
            goes_right = False
            while side < width:
                goes_right = bodies[side] == body and abs(depth_m[row, side] - z) < most
                if not (goes_right and side % _MOST_PIXELS and echoes[row, side] > _ZERO):
                    break
                joins = joins_below[row, side] and bodies_below[side] == body and under > row
                if joins != goes_down or (joins and abs(depth_m[under, side] - z_below) >= most):
                    break
                power += echoes[row, side]
                side += 1
            goes_right = goes_right and side < width
            start = _at(places, column)
            if goes_right:
                right = _difference(_at(places, side), start)
            else:
                step = np.float64(side - column) * np.float64(across[1] - across[0])
                right = _pixel_step(step * np.float64(z), 0, axes)
            if goes_down:
                below = _difference(_at(places_below, column), start)
            else:
                below = _pixel_step(np.float64(z) * np.float64(down[1] - down[0]), 1, axes)
            opposite = _sum(right, below)
            is_whole = goes_right and goes_down and bodies_below[side] == body
            if is_whole and abs(depth_m[under, side] - z_below) < most:
                opposite = _difference(_at(places_below, side), start)

            # Cells for its range, in the plane that it faces.
            square = start[3] * start[3] + start[4] * start[4] + start[5] * start[5]
            while level < last_level and square >= square_of[level + 1]:
                level += 1
            while level > 0 and square < square_of[level]:
                level -= 1
            per_m = 1.0 / edges_m[level]
            axis, area_m2 = _faced_axis(right, below, opposite)
            pa, pb, pc = _in_plane(start, axis, per_m)
            ea, eb, ec = _in_plane(right, axis, per_m)
            da, db, dc = _in_plane(below, axis, per_m)
            fa, fb, fc = _in_plane(opposite, axis, per_m)
            near_ua, near_ub, near_va, near_vb = _inverse(ea, eb, da, db)
            # The other triangle, seen from the opposite corner.
            far_va, far_vb, far_ua, far_ub = _inverse(da - fa, db - fb, ea - fa, eb - fb)
            a_low = min(min(ea, da), min(fa, 0.0))
            a_high = max(max(ea, da), max(fa, 0.0))
            b_low = min(min(eb, db), min(fb, 0.0))
            b_high = max(max(eb, db), max(fb, 0.0))
            first_k = np.int64(np.floor(pa + a_low))
            last_k = np.int64(np.floor(pa + a_high))
            first_j = np.int64(np.floor(pb + b_low))
            last_j = np.int64(np.floor(pb + b_high))
            salt = np.uint32(np.uint32(level * 4 + axis) * _LEVEL_SALT)
            if body > 0:
                salt = salt ^ salts[body - 1]
            weight = power / np.float32(area_m2 * per_m * per_m)
            for j in range(first_j, last_j + 1):
                base = np.uint32(np.uint32(j) * _STEPS_Y + salt)
                for k in range(first_k, last_k + 1):
                    name = mixed(np.uint32(np.uint32(k) * _STEPS_X + base))
                    a = np.float64(k) - pa + np.float64(np.int32(name & _LOWER_BITS)) * _PLACE_STEP
                    b = np.float64(j) - pb + np.float64(np.int32(name >> _16)) * _PLACE_STEP
                    u = a * near_ua + b * near_ub
                    v = a * near_va + b * near_vb
                    far_u = (a - fa) * far_ua + (b - fb) * far_ub
                    far_v = (a - fa) * far_va + (b - fb) * far_vb
                    is_near = (u >= 0) & (v >= 0) & (u + v < 1)
                    is_far = (far_u >= 0) & (far_v >= 0) & (far_u + far_v < 1)
                    # Most points of the cells lie beside the quad; one guess for the processor.
                    if not (is_near | is_far):
                        continue
                    w = 0.0
                    if not is_near:
                        u = far_u
                        v = far_v
                        w = 1.0 - u - v
                    ahead = start[3] + w * opposite[3] + u * right[3] + v * below[3]
                    left = start[4] + w * opposite[4] + u * right[4] + v * below[4]
                    up = start[5] + w * opposite[5] + u * right[5] + v * below[5]
                    along = pc + w * fc + u * ec + v * dc
                    line, into, beam = _bin_of(ahead, left, up, grid, beam_table)
                    if line < 0:
                        continue
                    begin = np.float64(np.int32(mixed(name) >> _16)) * _PLACE_STEP
                    layer = np.int64(np.floor(along * _LAYERS_PER_CELL + begin))
                    phase = np.uint16(0)
                    if turns_per_m > 0:
                        # At a height of the cell's own: surfaces between pixels are not known to
                        # parts of a wavelength, and the phase must not change with the pixels.
                        own_height = np.floor(along * _HEIGHTS_PER_CELL - begin) + begin
                        off_m = (own_height / _HEIGHTS_PER_CELL - along) * edges_m[level]
                        off_ahead, off_left, off_up = _off_the_plane(right, below, axis)
                        ahead += off_m * off_ahead
                        left += off_m * off_left
                        up += off_m * off_up
                        turns = np.sqrt(ahead * ahead + left * left + up * up) * turns_per_m
                        phase = np.uint16((turns - np.floor(turns)) * 65536.0)
                    name = np.uint32(name + np.uint32(np.uint32(layer) * _LAYER_SALT))
                    place = (line, into, beam, beams)
                    count = _add_to_bins(count, place, weight, name, phase, out)
    return count


@compiled(f"int64(int64, float32[::1], float32[::1], {_POINTS})")
def normalise(count: int, power: Float32s, total: Float32s, points: Any) -> int:
    """Make weights amplitudes that give each bin its power; returns how many points there are.

    power, total: (bins,), the power of each bin and the sum of the weights of its points.
    points: of `count` points, with room for one more in each bin: one is added where a bin echoes
    and no point lies in it.
    """
    bins, weights, names, phases = points
    for i in range(count):
        at = bins[i]
        weights[i] = np.sqrt(weights[i] * (power[at] / total[at]))
    for at in range(power.shape[0]):
        if power[at] > _ZERO and not total[at] > _ZERO:
            bins[count] = at
            weights[count] = np.sqrt(power[at])
            names[count] = np.uint32(at) * _GOLDEN
            phases[count] = 0
            count += 1
    return count
