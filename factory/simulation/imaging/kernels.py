"""Compiled loops of the complex field; see `simnfnd.factory.common.compiled`.

The steps that NumPy would take several times as long for, or add up in an order of its own.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...common.array_types import Bools, Float32s, Float64s, Int32s, UInt8s, UInt16s, UInt32s
from ...common.compiled import compiled
from ...common.elementary import rotated, rotation_numbers

_A = np.uint32(0x85EBCA6B)
_B = np.uint32(0xC2B2AE35)
_13 = np.uint32(13)
_16 = np.uint32(16)
_GOLDEN = np.uint32(0x9E3779B9)
_STEPS_X = np.uint32(73856093)
_STEPS_Y = np.uint32(19349663)
_STEPS_Z = np.uint32(83492791)
_ZERO = np.float32(0)
_ONE = np.float32(1)
_TWO = np.float32(2)
_FOUR = np.float32(4)
_TINY = np.float32(1e-6)

_BLOCK = 1024

_TABLE = "Array(float32, 1, 'C', readonly=True)"
_MATRIX = "Array(float32, 2, 'C', readonly=True)"
# Of a camera: depths (H, W), directions of its columns and rows, (u - cx) / fx and (v - cy) / fy.
_CAMERA = f"Tuple(({_MATRIX}, float32[::1], float32[::1]))"
# Of polar bins: whether ranges count along the ground, near_m, bins_per_m, range bins; (beams + 1,)
# sines of the beams' edges; a table that says where in it to begin, and its steps per sine.
_GRID = "Tuple((boolean, float64, float64, int64, float32[::1], int32[::1], float64))"


def scrambled(word: Any) -> Any:
    """32 bits -> 32 bits that look random: the finaliser of MurmurHash3 (public domain)."""
    word = np.uint32(np.uint32(word ^ (word >> _16)) * _A)
    word = np.uint32(np.uint32(word ^ (word >> _13)) * _B)
    return np.uint32(word ^ (word >> _16))


mixed = compiled()(scrambled)


@compiled()
def _corner(x: Any, y: Any, z: Any) -> Any:
    """32 bits for a cube of a lattice, given by three whole numbers of any sign; not yet mixed."""
    first = np.uint32(np.int64(x))
    second = np.uint32(np.int64(y))
    third = np.uint32(np.int64(z))
    return np.uint32(first * _STEPS_X + second * _STEPS_Y + third * _STEPS_Z)


# --- beams ------------------------------------------------------------------------------------


@compiled(f"void(float32[:, ::1], {_MATRIX}, float32[:, ::1])")
def products(rows: Float32s, matrix: Float32s, out: Float32s) -> None:
    """(n, m) times (m, k), n and m multiples of 4; the order of the sums is fixed.

    Four rows by four sources at a time: each number that is loaded or stored serves four products.
    """
    for row in range(0, rows.shape[0], 4):
        first = out[row]
        second = out[row + 1]
        third = out[row + 2]
        fourth = out[row + 3]
        for at in range(matrix.shape[1]):
            first[at] = second[at] = third[at] = fourth[at] = 0
        for i in range(0, matrix.shape[0], 4):
            # Where nothing echoes, as in most bins of a frame, nothing is added.
            silent = True
            for line in range(row, row + 4):
                four = rows[line, i : i + 4]
                silent = silent and not (four[0] or four[1] or four[2] or four[3])
            if silent:
                continue
            m0 = matrix[i]
            m1 = matrix[i + 1]
            m2 = matrix[i + 2]
            m3 = matrix[i + 3]
            a = rows[row]
            b = rows[row + 1]
            c = rows[row + 2]
            d = rows[row + 3]
            a0 = a[i]
            a1 = a[i + 1]
            a2 = a[i + 2]
            a3 = a[i + 3]
            b0 = b[i]
            b1 = b[i + 1]
            b2 = b[i + 2]
            b3 = b[i + 3]
            c0 = c[i]
            c1 = c[i + 1]
            c2 = c[i + 2]
            c3 = c[i + 3]
            d0 = d[i]
            d1 = d[i + 1]
            d2 = d[i + 2]
            d3 = d[i + 3]
            for at in range(matrix.shape[1]):
                w0 = m0[at]
                w1 = m1[at]
                w2 = m2[at]
                w3 = m3[at]
                first[at] += a0 * w0 + a1 * w1 + a2 * w2 + a3 * w3
                second[at] += b0 * w0 + b1 * w1 + b2 * w2 + b3 * w3
                third[at] += c0 * w0 + c1 * w1 + c2 * w2 + c3 * w3
                fourth[at] += d0 * w0 + d1 * w1 + d2 * w2 + d3 * w3


@compiled(f"void(uint32, {_MATRIX}, float32[::1], float32[::1], float32[:, :, ::1])")
def add_white(
    key: int, table: Float32s, along: Float32s, across: Float32s, planes: Float32s
) -> None:
    """Add complex circular noise, a function of the key and the place.

    along, across: its amplitude is their product, (rows,) and (beams,).  planes: (2, rows, beams).
    """
    rows, beams = planes.shape[1:]
    drawn = np.empty(beams, np.uint32)
    for row in range(rows):
        for beam in range(beams):  # several at a time, unlike what is looked up
            place = np.uint32(row * beams + beam)
            drawn[beam] = mixed(np.uint32(mixed(place) ^ key)) >> _16
        real = planes[0, row]
        imaginary = planes[1, row]
        level = along[row]
        for beam in range(beams):
            amplitude = level * across[beam]
            real[beam] += amplitude * table[drawn[beam], 0]
            imaginary[beam] += amplitude * table[drawn[beam], 1]


# --- from rendered pixels to scatterers -------------------------------------------------------

# When neighbours are one surface, as in `render.kernels.joints`: parts of the depth, and of a step.
_SMALL_STEP = np.float32(0.02)
_LARGE_STEP = np.float32(0.1)
_SLOPE_CHANGE = np.float32(3)
# Of the power density from one row to the next.
_MOST_CHANGE = np.float32(3)


@compiled()
def _bounded(value: Any, most: Any) -> Any:
    """A whole number from 0 to `most`; NaN is 0."""
    value = value if value > _ZERO else _ZERO
    return np.int32(value if value < most else most)


@compiled()
def _ground_step_m(step_m: Any, neighbour_m: Any) -> Any:
    """The size of a neighbouring step in depth, where it continues the step; else of the step."""
    continues = step_m * neighbour_m > _ZERO
    size_m = abs(step_m)
    neighbour_size_m = abs(neighbour_m)
    alike = neighbour_size_m < _SLOPE_CHANGE * size_m and size_m < _SLOPE_CHANGE * neighbour_size_m
    return neighbour_size_m if continues and alike else size_m


@compiled()
def _is_one_surface(nearer_m: Any, step_m: Any, step_above_m: Any, step_below_m: Any) -> Any:
    """Whether a pixel and the one below it show one surface.

    The ground far away is a run of large steps in depth; an outline is a single one.

    nearer_m: the smaller depth of the two.  step_m: from the pixel to the one below.
    step_above_m, step_below_m: the steps before and after it.
    """
    size_m = abs(step_m)
    run_m = max(step_above_m, step_below_m) if step_m > 0 else -min(step_above_m, step_below_m)
    is_sloping = size_m < _LARGE_STEP * nearer_m and size_m < _SLOPE_CHANGE * run_m
    return size_m < _SMALL_STEP * nearer_m or is_sloping


@compiled()
def _interpolated(table: Any, place: Any, last_step: Any) -> Any:
    """Value of a table between its entries, linearly; place: index with its fraction."""
    step = _bounded(place, last_step)
    lower = table[step]
    upper = table[step + 1]
    return lower + (place - np.float32(step)) * (upper - lower)


@compiled()
def _density_tilt(
    value: Any, value_below: Any, step_m: Any, step_above_m: Any, step_below_m: Any
) -> Any:
    """How the power density changes from a pixel to the one below it; see `_share_before`.

    At each of the two rows the density is that row's power over its own step in depth.
    """
    size_m = abs(step_m)
    ratio = value_below / value
    ratio *= (_ground_step_m(step_m, step_above_m) + size_m) / max(
        _ground_step_m(step_m, step_below_m) + size_m, _TINY
    )
    ratio = min(max(ratio, _ONE / _MOST_CHANGE), _MOST_CHANGE)
    return (ratio - _ONE) / (ratio + _ONE) if value_below > _ZERO else _ZERO


@compiled()
def _share_before(part: Any, tilt: Any) -> Any:
    """Share of a pixel's power in its first part, 0 to 1; its density is 1 + tilt (2 part - 1)."""
    return part * (_ONE + tilt * (part - _ONE))


@compiled()
def _project_row(
    depth_m: Float32s, radiance: Float32s, across: Float32s, down: float, rotation: Float32s,
    position_m: Float32s, ground_up: Float32s, near_m: Any, bins_per_m: Any, columns_out: Float32s,
) -> None:  # fmt: skip
    """Bearing, elevation, range bin and echo power of a row of camera pixels.

    Apart from the loop that places scatterers, so that a processor does several pixels at once.

    depth_m, radiance, across: (W,) of the row; down: its direction, (v - cy) / fy.
    rotation, position_m: sonar axes from camera axes.
    ground_up: the sonar's upward axis in camera axes where ranges count along the ground, else 0.
    columns_out: (4, W) out: sine of the bearing (inf behind the sonar), sine of the elevation,
    range bin with its fraction, radiance times the pixel's solid angle.
    """
    # Local names: the compiler then knows that what it writes changes none of them.
    turn = rotation_numbers(rotation)
    g0 = ground_up[0]
    g1 = ground_up[1]
    g2 = ground_up[2]
    px = position_m[0]
    py = position_m[1]
    pz = position_m[2]
    bearing = columns_out[0]
    sine = columns_out[1]
    start = columns_out[2]
    value = columns_out[3]
    for column in range(depth_m.shape[0]):
        a = across[column]
        z = depth_m[column]
        x_ = a * z - px
        y_ = down * z - py
        z_ = z - pz
        x, y, up = rotated(turn, x_, y_, z_)
        per_range = _ONE / np.sqrt(x * x + y * y + up * up)
        bearing[column] = -y * per_range if x > 0 else np.float32(np.inf)
        sine[column] = up * per_range
        up = g0 * x_ + g1 * y_ + g2 * z_
        square_m2 = x_ * x_ + y_ * y_ + z_ * z_ - up * up
        start[column] = (np.sqrt(max(square_m2, _ZERO)) - near_m) * bins_per_m
        square = _ONE / (_ONE + a * a + down * down)
        value[column] = radiance[column] * square * np.sqrt(square)


@compiled()
def _beam_at(bearing: Any, first_bearing: Any, beam_table: Any) -> Any:
    """The beam in which the sine of a bearing lies, which must lie in the sector.

    beam_table: (beams + 1,) sines of the edges; the beam to begin with at equal steps of the sine;
    steps a sine; last of the steps.
    """
    edges, first_beam, steps_per_sine, last_step = beam_table
    beam = first_beam[_bounded((bearing - first_bearing) * steps_per_sine, last_step)]
    while bearing >= edges[beam + 1]:
        beam += 1
    return beam


@compiled()
def _fill_two_bins(pixel: Any, value: Any, in_beam: Any, span: Any, beam: Any, bins: Any) -> None:
    """Add the echo of a pixel that covers one range bin, or parts of two; most do.

    value: its power.  in_beam: whether the beam's opening holds it.
    span: nearest and farthest range bin with fractions.  beam: its number, and how many there are.
    bins: see `place_scatterers`.
    """
    near, far = span
    number, beams = beam
    power, owner, fills_bin = bins
    last_row = np.float32(power.shape[0] // beams - 1)
    first = _bounded(near, last_row)
    last = _bounded(far, last_row)
    inside = min((np.float32(last) - near) / max(far - near, _TINY), _ONE)
    share = inside if last > first else _ONE
    nearest = first * beams + number
    power[last * beams + number] += value * (_ONE - share)
    power[nearest] += value * share
    owner[nearest] = pixel
    if in_beam:
        fills_bin[nearest] = True


@compiled()
def _fill_bins(
    pixel: Any, value: Any, in_beam: Any, ends: Any, tilt: Any, beam: Any, bins: Any
) -> None:
    """Add the echo of a pixel that covers several range bins, each in its share.

    ends: range bin with its fraction at the pixel and at the one below.  tilt: see `_share_before`.
    value, in_beam, beam, bins: see `_fill_two_bins`.
    """
    start, end = ends
    number, beams = beam
    power, owner, fills_bin = bins
    rows = power.shape[0] // beams
    near = min(start, end)
    far = max(start, end)
    per_row = _ONE / (end - start) if end != start else _ZERO
    for row in range(int(max(near, _ZERO)), min(int(far), rows - 1) + 1):
        first_part = (max(near, np.float32(row)) - start) * per_row
        last_part = (min(far, np.float32(row + 1)) - start) * per_row
        share = _share_before(last_part, tilt) - _share_before(first_part, tilt)
        flat_bin = row * beams + number
        power[flat_bin] += value * abs(share)
        owner[flat_bin] = pixel
        fills_bin[flat_bin] |= in_beam


@compiled(
    f"int64({_CAMERA}, {_MATRIX}, Array(uint8, 2, 'C', readonly=True), {_MATRIX}, float32[::1],"
    f" Tuple((float32[:, ::1], float32[::1])), {_GRID}, float32[::1], float32,"
    " Tuple((float32[::1], int32[::1], boolean[::1])), float32[:, ::1], boolean[:, ::1])"
)
def place_scatterers(
    camera: Any, radiance: Float32s, labels: UInt8s, factor: Float32s,
    reflectivity: Float32s, sonar: Any, grid: Any, pattern: Float32s, widest_sine: float,
    bins: Any, echoes: Float32s, joins_below: Bools,
) -> int:  # fmt: skip
    """The echo of each lit pixel, in exact parts of polar bins; returns how many echo.

    A pixel covers the ranges from its own to that of the pixel below it, where both are one
    surface: at grazing incidence there are fewer pixels than bins.  There its power density changes
    evenly from row to row, or the rows would show as stripes.
    Beams are cones, see `Echoes.in_conical_beams`.

    camera, grid: see above.  radiance: (H, W).  labels: (H, W), or (0, 0) when all are 0;
    reflectivity: of each, the last of those beyond, too.
    factor: (H, W) multiplies the radiance, or (0, 0).
    sonar: rotation and position, sonar axes from camera axes.
    pattern: vertical intensity pattern at equal steps of sin(elevation) from -1 to 1.
    bins: out, (bins,) each, summed power and last pixel of a bin (-1: none), and whether a pixel
    within sin(elevation) of +-widest_sine fills it.
    echoes: (H, W) zeros, out, the power of each pixel.  joins_below: (H, W) out, whether the pixel
    below one that echoes shows the same surface.
    """
    depth_m, across, down = camera
    rotation, position_m = sonar
    ground_range, from_m, per_m, rows, edges, first_beam, per_sine = grid
    near_m = np.float32(from_m)
    bins_per_m = np.float32(per_m)
    height, width = depth_m.shape
    beams = edges.shape[0] - 1
    low = edges[0]
    high = edges[beams]
    beam_table = (edges, first_beam, np.float32(per_sine), np.float32(first_beam.shape[0] - 1))
    half_steps = np.float32(0.5 * (pattern.shape[0] - 1))
    last_step = np.float32(pattern.shape[0] - 2)
    last_label = reflectivity.shape[0] - 1
    beyond = np.float32(rows)
    ground_up = rotation[2] if ground_range else np.zeros(3, np.float32)
    row_columns = np.empty((2, 4, width), np.float32)
    count = 0
    for row in range(-1, height):
        under = min(row + 1, height - 1)
        _project_row(
            depth_m[under], radiance[under], across, down[under], rotation, position_m, ground_up,
            near_m, bins_per_m, row_columns[(row + 1) & 1],
        )  # fmt: skip
        if row < 0:
            continue
        bearings, sines, starts, values = row_columns[row & 1]
        below = row_columns[(row + 1) & 1, 2]
        value_below = row_columns[(row + 1) & 1, 3]
        for column in range(width):
            value = values[column]
            bearing = bearings[column]
            if not (value > _ZERO and low <= bearing and bearing < high):
                continue

            # The ranges that the pixel covers.
            z = depth_m[row, column]
            z_below = depth_m[under, column]
            step_m = z_below - z
            step_above_m = z - depth_m[max(row - 1, 0), column]
            step_below_m = depth_m[min(row + 2, height - 1), column] - z_below
            start = end = starts[column]
            is_joined = _is_one_surface(min(z, z_below), step_m, step_above_m, step_below_m)
            if is_joined:
                end = below[column]
            near = min(start, end)
            far = max(start, end)
            if not (far >= _ZERO and near < beyond):
                continue

            # Its beam, and its power through the beam's pattern.
            beam = (_beam_at(bearing, low, beam_table), beams)
            in_beam = abs(sines[column]) <= widest_sine
            value *= _interpolated(pattern, (sines[column] + _ONE) * half_steps, last_step)
            label = np.int64(labels[row, column]) if labels.shape[0] else 0
            value *= reflectivity[min(label, last_label)]
            if factor.shape[0]:
                value *= factor[row, column]

            pixel = row * width + column
            ends = (start, end)
            span = far - near
            if span <= _ONE and near >= _ZERO and far < beyond:
                _fill_two_bins(pixel, value, in_beam, (near, far), beam, bins)
            else:
                tilt = _density_tilt(
                    values[column], value_below[column], step_m, step_above_m, step_below_m
                )
                _fill_bins(pixel, value, in_beam, ends, tilt, beam, bins)
            echoes[row, column] = value
            joins_below[row, column] = is_joined
            count += 1
    return count


@compiled(
    "void(int32[::1], float32[::1], uint32[::1], uint16[::1], uint32,"
    f" UniTuple({_MATRIX}, 2), float32[:, ::1])"
)
def scatter(
    bin_of: Int32s, amplitude_of: Float32s, name_of: UInt32s, phase_of: UInt16s, key: int,
    tables: Any, bins: Float32s,
) -> None:  # fmt: skip
    """Add each point's amplitude times its coefficient to its bin; bins: (bins, 2).

    The complex coefficient of a name is drawn by `key` from the first of the tables (65536, 2) and
    turned by exp(-2 pi i phase / 65536), whose cosines and sines are the second; phase_of (0,):
    none.
    """
    table, turns = tables
    for i in range(bin_of.shape[0]):
        at = bin_of[i]
        entry = mixed(np.uint32(name_of[i] ^ key)) >> _16
        real = amplitude_of[i] * table[entry, 0]
        imaginary = amplitude_of[i] * table[entry, 1]
        if phase_of.shape[0]:
            c = turns[phase_of[i], 0]
            s = turns[phase_of[i], 1]
            real, imaginary = real * c + imaginary * s, imaginary * c - real * s
        bins[at, 0] += real
        bins[at, 1] += imaginary


@compiled()
def _smooth(part: Any) -> Any:
    """0 to 1 as a step that begins and ends level."""
    return part * part * (np.float32(3) - part - part)


@compiled(f"void(float32[:, ::1], float64[:, ::1], uint32, {_MATRIX}, float32[::1])")
def lattice(
    points_m: Float32s, lattice_from_camera: Float64s, key: int, table: Float32s, normal: Float32s
) -> None:
    """A standard normal field at (3, N) points, smooth over distances of 1 after (3, 4).

    Random values at the corners of unit cubes, weighted by smooth steps and brought back to unit
    variance.  table: (65536, 2) normal values of variance 1/2.
    """
    m = lattice_from_camera
    for i in range(points_m.shape[1]):
        a = points_m[0, i]
        b = points_m[1, i]
        c = points_m[2, i]
        p = m[0, 0] * a + m[0, 1] * b + m[0, 2] * c + m[0, 3]
        q = m[1, 0] * a + m[1, 1] * b + m[1, 2] * c + m[1, 3]
        r = m[2, 0] * a + m[2, 1] * b + m[2, 2] * c + m[2, 3]
        x = np.floor(p)
        y = np.floor(q)
        z = np.floor(r)
        u = _smooth(np.float32(p - x))
        v = _smooth(np.float32(q - y))
        w = _smooth(np.float32(r - z))
        u_ = _ONE - u
        v_ = _ONE - v
        w_ = _ONE - w
        corner = _corner(np.int32(x), np.int32(y), np.int32(z))
        level = _ZERO
        for above in range(2):
            side = _ZERO
            for beyond in range(2):
                at = np.uint32(corner + np.uint32(beyond) * _STEPS_Y + np.uint32(above) * _STEPS_Z)
                left_value = table[mixed(np.uint32(mixed(at) ^ key)) >> _16, 0]
                at = np.uint32(at + _STEPS_X)
                right_value = table[mixed(np.uint32(mixed(at) ^ key)) >> _16, 0]
                side += (v if beyond else v_) * (u_ * left_value + u * right_value)
            level += (w if above else w_) * side
        squares = (u * u + u_ * u_) * (v * v + v_ * v_) * (w * w + w_ * w_)
        normal[i] = level * np.sqrt(_TWO / squares)


# --- ghosts -----------------------------------------------------------------------------------

# Weakest amplitude of the straight way that a mirrored one is compared with.
_FAINTEST = np.float32(1e-4)
_NEAREST_M = np.float32(1e-3)  # keeps directions finite


@compiled(
    "void(int32[::1], float32[:, ::1], Tuple((float32[:, ::1], float32[::1])),"
    f" UniTuple(float32, 3), {_TABLE}, float32, float32, float32, int64,"
    " UniTuple(Tuple((float32[::1], float32[:, ::1])), 2))"
)
def mirror(
    sources: Int32s, points_m: Float32s, sonar: Any, level: Any, pattern: Float32s, loss: float,
    nepers_per_m: float, bins_per_m: float, beams: int, echoes: Any,
) -> None:  # fmt: skip
    """Add to each bin what comes to it by way of a plane; see `noise.paths`.

    sources: (M,) flat bins; points_m: (3, M) where they are, camera axes.  sonar: as of `place`.
    level: height of the plane above the sonar, cosine and sine of the sonar's tilt.  pattern: as of
    `place`.  loss: intensity that one reflection leaves; nepers_per_m: absorption of intensity, one
    way.  echoes: (bins,) intensities and (fields, bins) amplitudes, and the same again, which are
    added to, but (0,) intensities where all are 0.
    """
    rotation, position_m = sonar
    turn = rotation_numbers(rotation)
    height_m, cosine, sine = level
    (power, planes), (power_out, planes_out) = echoes
    bins = power.shape[0]
    steps = np.float32((pattern.shape[0] - 1) / 2)
    # What absorption leaves of the longer way, in steps of a range bin, linear in between.
    left = np.empty(2 * (bins // beams) + 2, np.float32)
    for step in range(left.shape[0]):
        left[step] = loss * np.exp(-nepers_per_m * np.float32(step) / bins_per_m)
    most = np.float32(left.shape[0] - 2)
    for i in range(sources.shape[0]):
        u = points_m[0, i] - position_m[0]
        v = points_m[1, i] - position_m[1]
        w = points_m[2, i] - position_m[2]
        x, y, z = rotated(turn, u, v, w)
        ahead = x * cosine + z * sine
        up = z * cosine - x * sine
        up_image = _TWO * height_m - up
        flat2 = ahead * ahead + y * y
        r = max(np.sqrt(flat2 + up * up), _NEAREST_M)
        r_image = max(np.sqrt(flat2 + up_image * up_image), _NEAREST_M)
        longer = max(r_image - r, _ZERO)
        # The direction of departure in the sonar's own axes.
        image_sine = (up_image * cosine + ahead * sine) / r_image
        towards = pattern[int(np.rint((image_sine + _ONE) * steps))]
        straight = np.sqrt(pattern[int(np.rint((z / r + _ONE) * steps))])
        spread = r / (r + longer)
        away = min(longer * bins_per_m, most)
        whole = int(away)
        lower = left[whole]
        upper = left[whole + 1]
        once = np.sqrt(towards) / max(straight, _FAINTEST) * spread * spread
        once *= lower + (away - np.float32(whole)) * (upper - lower)
        source = np.int64(sources[i])
        target = source + beams * np.int64(np.rint(longer * bins_per_m / _TWO))
        if target >= bins:
            continue
        amplitude = _TWO * np.sqrt(once)
        for plane in range(planes.shape[0]):
            planes_out[plane, target] += amplitude * planes[plane, source]
        if power_out.shape[0]:
            power_out[target] += _FOUR * once * power[source]
        twice = source + beams * np.int64(np.rint(longer * bins_per_m))
        if twice < bins:
            for plane in range(planes.shape[0]):
                planes_out[plane, twice] += once * planes[plane, source]
            if power_out.shape[0]:
                power_out[twice] += once * once * power[source]
