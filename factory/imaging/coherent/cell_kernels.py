"""Compiled loops over the cells of the world in which scatterers lie; see `factory.compiled`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ...compiled import compiled
from .kernels import mixed

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]

STEPS_X, STEPS_Y, STEPS_Z = np.uint32(73856093), np.uint32(19349663), np.uint32(83492791)
_1, _2, _3 = np.uint32(1), np.uint32(2), np.uint32(3)
_9, _16, _HALF = np.uint32(9), np.uint32(16), np.int32(1)
_NOTHING = np.uint64(0)
_BLOCK = 1024


@compiled()
def lattice_sum(x: Any, y: Any, z: Any) -> Any:
    """32 bits for a cube of a lattice, given by three whole numbers of any sign; not yet mixed."""
    first, second, third = np.uint32(np.int64(x)), np.uint32(np.int64(y)), np.uint32(np.int64(z))
    return np.uint32(first * STEPS_X + second * STEPS_Y + third * STEPS_Z)


@compiled(
    "void(int32[::1], float32[::1], int32[::1], Array(float32, 2, 'C', readonly=True),"
    " float32[::1], float32[::1], float64[:, ::1], float64, uint32[::1], uint32[::1])"
)
def cells(
    pixels: npt.NDArray[np.int32],
    parts: Floats,
    row_end: npt.NDArray[np.int32],
    depth_m: Floats,
    across: Floats,
    down: Floats,
    world_from_camera: npt.NDArray[np.float64],
    cell_m: float,
    name_of: npt.NDArray[np.uint32],
    place_of: npt.NDArray[np.uint32],
) -> None:
    """The world cells in which scatterers lie.

    pixels, parts, row_end: as `placing.place` gives them.  cell_m: edge of a cell, a cube.
    name_of, place_of: (N,) out, the cell of each as a number that looks random, and where to look
    for it in a table (neighbours are close together).
    """
    height, width = depth_m.shape
    m = world_from_camera / cell_m
    m00, m01, m02, m03 = m[0]
    m10, m11, m12, m13 = m[1]
    m20, m21, m22, m23 = m[2]
    # Whole cells apart, for 32 bits are converted faster than 64, and must be enough.
    w0, w1, w2 = np.floor(m03), np.floor(m13), np.floor(m23)
    m03, m13, m23 = m03 - w0, m13 - w1, m23 - w2
    i0, i1, i2 = np.int32(np.int64(w0)), np.int32(np.int64(w1)), np.int32(np.int64(w2))
    xs, ys, zs = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    us, vs = np.empty(_BLOCK, np.int32), np.empty(_BLOCK, np.int32)
    ws = np.empty(_BLOCK, np.int32)
    stop = 0
    for row in range(height):
        below = min(row + 1, height - 1)
        here_m, below_m = depth_m[row], depth_m[below]
        down_here, down_below = np.float64(down[row]), np.float64(down[below])
        before = np.int32(row * width)
        start, stop = stop, int(row_end[row])
        # A block at a time: first what a processor does for many at once, then what it cannot.
        for begin in range(start, stop, _BLOCK):
            size = min(_BLOCK, stop - begin)
            some, some_parts = pixels[begin : begin + size], parts[begin : begin + size]
            for i in range(size):
                column = np.uint32(some[i] - before)
                z, part = np.float64(here_m[column]), np.float64(some_parts[i])
                y = down_here * z
                z_below = np.float64(below_m[column])
                ys[i] = y + part * (down_below * z_below - y)
                zs[i] = z + part * (z_below - z)
                xs[i] = np.float64(across[column]) * zs[i]
            for i in range(size):
                x, y, z = xs[i], ys[i], zs[i]
                us[i] = np.int32(np.floor(m00 * x + m01 * y + m02 * z + m03))
                vs[i] = np.int32(np.floor(m10 * x + m11 * y + m12 * z + m13))
                ws[i] = np.int32(np.floor(m20 * x + m21 * y + m22 * z + m23))
            names, places = name_of[begin : begin + size], place_of[begin : begin + size]
            for i in range(size):
                first, second = np.int32(us[i] + i0), np.int32(vs[i] + i1)
                third = np.int32(ws[i] + i2)
                names[i] = mixed(lattice_sum(first, second, third))
                # Eight cells, a cube, lie side by side: one line of the processor's memory.
                block = mixed(lattice_sum(first >> _HALF, second >> _HALF, third >> _HALF))
                inside = np.uint32(first) & _1 | (np.uint32(second) & _1) << _1
                places[i] = np.uint32(block << _3) | inside | (np.uint32(third) & _1) << _2


@compiled("boolean(uint32[::1], uint32[::1], int64, uint32[:, ::1], uint32[:, ::1], float32[::1])")
def count(
    name_of: npt.NDArray[np.uint32],
    place_of: npt.NDArray[np.uint32],
    parts: int,
    table: npt.NDArray[np.uint32],
    sorted_: npt.NDArray[np.uint32],
    share_of: Floats,
) -> Any:
    """1 / sqrt(points of its cell) for each point: amplitudes that add up coherently.

    name_of, place_of: as `cells` gives them; share_of: (N,) out.  The cells are counted in parts,
    a power of two, each with a table that a processor holds close by.
    table: (slots, 2), slots a power of two; sorted_: (N, 2), both overwritten.
    Returns False where a part does not fit the table; share_of then says nothing.
    """
    mask, last = np.uint32(table.shape[0] - 1), np.uint32(parts - 1)
    shift = np.uint32(0)
    while np.uint32(1) << shift <= mask:
        shift += np.uint32(1)
    ends = np.zeros(parts + 1, np.int64)
    for point in range(place_of.shape[0]):
        ends[np.uint32((place_of[point] >> shift) & last) + np.uint32(1)] += 1
    if ends.max() > np.int64(mask):
        return False
    for number in range(parts):
        ends[number + 1] += ends[number]
    # Name and place lie side by side: there are then only as many places to write to as parts.
    free = ends[:-1].copy()
    for point in range(name_of.shape[0]):
        place = place_of[point]
        among = np.uint32((place >> shift) & last)
        at = np.uint32(free[among])
        free[among] += 1
        sorted_[at, 0], sorted_[at, 1] = name_of[point], place & mask
    for part in range(parts):
        table[:] = 0
        for i in range(ends[part], ends[part + 1]):
            at = np.uint32(i)
            name, slot = sorted_[at, 0], sorted_[at, 1]
            # Taken, and by another: a product instead of `and` or `&`, of which the compiler makes
            # two branches.  Whether a cell is new cannot be foretold, and a wrong guess costs much.
            while np.uint64(table[slot, 1]) * np.uint64(table[slot, 0] ^ name) != _NOTHING:
                slot = np.uint32(slot + _9) & mask
            table[slot, 0] = name
            table[slot, 1] += _1
            sorted_[at, 1] = slot
        for i in range(ends[part], ends[part + 1]):
            at = np.uint32(i)
            sorted_[at, 0] = table[sorted_[at, 1], 1]
    # In the order of the points again, each part being read from its beginning.
    free[:] = ends[:-1]
    for point in range(place_of.shape[0]):
        among = np.uint32((place_of[point] >> shift) & last)
        found = np.float32(np.int32(sorted_[np.uint32(free[among]), 0]))
        free[among] += 1
        share_of[point] = np.float32(1) / np.sqrt(found)
    return True


@compiled(
    "void(int32[::1], float32[::1], uint32[::1], float32[::1], uint32, float32[:, ::1],"
    " float32[:, ::1])"
)
def scatter(
    bin_of: npt.NDArray[np.int32],
    power_of: Floats,
    name_of: npt.NDArray[np.uint32],
    share_of: Floats,
    key: int,
    table: Floats,
    bins: Floats,
) -> None:
    """Add each point's amplitude times the coefficient of its cell to its bin; bins: (bins, 2).

    name_of, share_of: cell and share of each point.  The complex coefficient of a cell is drawn by
    `key` from the table (65536, 2).
    """
    root, lots = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.uint32)
    for begin in range(0, bin_of.shape[0], _BLOCK):
        size = min(_BLOCK, bin_of.shape[0] - begin)
        some, some_powers = bin_of[begin : begin + size], power_of[begin : begin + size]
        names, shares = name_of[begin : begin + size], share_of[begin : begin + size]
        for i in range(size):
            root[i] = np.sqrt(some_powers[i])
        for i in range(size):
            lots[i] = mixed(np.uint32(names[i] ^ key)) >> _16
        for i in range(size):
            at, lot = np.uint32(some[i]), lots[i]
            bins[at, 0] += root[i] * (shares[i] * table[lot, 0])
            bins[at, 1] += root[i] * (shares[i] * table[lot, 1])


@compiled("void(float32[:, ::1], float32[::1], float32[:, :, ::1])")
def into_planes(bins: Floats, amplitude: Floats, planes: Floats) -> None:
    """(rows * beams, 2) into planes of their own, (2, rows, beams), times an amplitude a row."""
    _, rows, beams = planes.shape
    for row in range(rows):
        real, imaginary, factor = planes[0, row], planes[1, row], amplitude[row]
        pairs = bins[row * beams : row * beams + beams]
        for beam in range(beams):
            real[beam] = factor * pairs[beam, 0]
            imaginary[beam] = factor * pairs[beam, 1]


_1, _8, _16 = np.uint32(1), np.uint32(8), np.uint32(16)
_X, _Y, _Z = np.uint32(0x68BC21EB), np.uint32(0x02E5BE93), np.uint32(0x967A889B)
# A pixel is one surface with its right neighbour up to this step, a part of the depth.
_STEP = 0.05
# Points of a pixel across and down, at most.
_MOST_ACROSS, _MOST_DOWN = 16, 8


@compiled()
def _fraction(name: Any, salt: Any) -> Any:
    """A number of 0 to 1 that belongs to a cell."""
    return np.float64(mixed(np.uint32(name ^ salt)) >> _8) * 2.0**-24


@compiled(
    "int64(int32[::1], float32[::1], float32[::1], Array(float32, 2, 'C', readonly=True),"
    " float32[::1], float32[::1], float64[:, ::1], float64, uint32[::1], float32[::1],"
    " int32[:, ::1])"
)
def gather(
    pixels: npt.NDArray[np.int32],
    parts: Floats,
    powers: Floats,
    depth_m: Floats,
    across: Floats,
    down: Floats,
    world_from_camera: Doubles,
    cell_m: float,
    name_of: npt.NDArray[np.uint32],
    power_of: Floats,
    place_of: npt.NDArray[np.int32],
) -> Any:
    """Spread the scatterers over the cells of the world; returns how many points that takes.

    Each pixel is filled with points half a cell apart, towards the pixel below and the one to the
    right as far as these are one surface with it.
    pixels, parts, powers: as `placing.place` gives them.  name_of, power_of: (slots,) zeros, a
    table of cells: their number (looks random, not 0) and power; slots a power of two, more than
    there are cells.  place_of: (slots, 3), the cell.  With tables of no slots it only counts.
    """
    height, width = depth_m.shape
    mask = np.uint32(max(name_of.shape[0] - 1, 0))
    filling = name_of.shape[0] > 0
    m = world_from_camera / cell_m
    half_m, count = 0.5 * cell_m, np.int64(0)
    first, size = 0, pixels.shape[0]
    while first < size:
        pixel = pixels[first]
        last = first + 1
        while last < size and pixels[last] == pixel:
            last += 1
        row, column = pixel // width, pixel % width
        z = np.float64(depth_m[row, column])
        x, y = np.float64(across[column]) * z, np.float64(down[row]) * z
        dx = dy = dz = np.float64(0)
        if parts[first] != 0 and row + 1 < height:
            below = np.float64(depth_m[row + 1, column])
            dx = np.float64(across[column]) * below - x
            dy, dz = np.float64(down[row + 1]) * below - y, below - z
        ex = ey = ez = np.float64(0)
        if column + 1 < width:
            right = np.float64(depth_m[row, column + 1])
            if abs(right - z) < _STEP * z:
                ex = np.float64(across[column + 1]) * right - x
                ey, ez = np.float64(down[row]) * right - y, right - z
        many = last - first
        sideways = int(np.ceil(np.sqrt(ex * ex + ey * ey + ez * ez) / half_m))
        downward = int(np.ceil(np.sqrt(dx * dx + dy * dy + dz * dz) / many / half_m))
        sideways = min(max(sideways, 1), _MOST_ACROSS)
        downward = min(max(downward, 1), _MOST_DOWN)
        count += many * sideways * downward
        if not filling:
            first = last
            continue
        for number in range(many):
            share = powers[first + number] / np.float32(sideways * downward)
            for b in range(downward):
                v = (number + (b + 0.5) / downward) / many
                for a in range(sideways):
                    u = (a + 0.5) / sideways - 0.5
                    px, py, pz = x + v * dx + u * ex, y + v * dy + u * ey, z + v * dz + u * ez
                    i = np.floor(m[0, 0] * px + m[0, 1] * py + m[0, 2] * pz + m[0, 3])
                    j = np.floor(m[1, 0] * px + m[1, 1] * py + m[1, 2] * pz + m[1, 3])
                    k = np.floor(m[2, 0] * px + m[2, 1] * py + m[2, 2] * pz + m[2, 3])
                    name = np.uint32(mixed(lattice_sum(i, j, k)) | _1)
                    slot = np.uint32(name >> _1) & mask
                    while name_of[slot] != 0 and name_of[slot] != name:
                        slot = np.uint32(slot + _1) & mask
                    if name_of[slot] == 0:
                        name_of[slot] = name
                        place_of[slot, 0] = np.int32(i)
                        place_of[slot, 1] = np.int32(j)
                        place_of[slot, 2] = np.int32(k)
                    power_of[slot] += share
        first = last
    return count


@compiled(
    "int64(uint32[::1], float32[::1], int32[:, ::1], float64, float64[:, ::1], boolean, float64,"
    " float64, float32[::1], int32[::1], float64, int64, float64, int32[::1], float32[::1],"
    " uint32[::1], uint16[::1])"
)
def locate(
    name_of: npt.NDArray[np.uint32],
    power_of: Floats,
    place_of: npt.NDArray[np.int32],
    cell_m: float,
    sonar_from_world: Doubles,
    ground_range: bool,
    near_m: float,
    bins_per_m: float,
    edges: Floats,
    first_beam: npt.NDArray[np.int32],
    beam_scale: float,
    rows: int,
    waves_per_m: float,
    bin_of: npt.NDArray[np.int32],
    root_of: Floats,
    cell_of: npt.NDArray[np.uint32],
    phase_of: npt.NDArray[np.uint16],
) -> Any:
    """The polar bin, amplitude and phase of every cell in the picture; returns how many there are.

    A cell echoes from one point in it, which is the cell's own.  waves_per_m: wavelengths of the
    two-way path a metre of range.  The rest is as in `placing.place`; bin_of ... phase_of: out,
    phases in 1 / 65536 of a turn.
    """
    m, beams = sonar_from_world, edges.shape[0] - 1
    low, high = np.float64(edges[0]), np.float64(edges[beams])
    count = 0
    for slot in range(name_of.shape[0]):
        name = name_of[slot]
        if name == 0 or power_of[slot] <= 0:
            continue
        x = (place_of[slot, 0] + _fraction(name, _X)) * cell_m
        y = (place_of[slot, 1] + _fraction(name, _Y)) * cell_m
        z = (place_of[slot, 2] + _fraction(name, _Z)) * cell_m
        ahead = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
        left = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
        up = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        ground = ahead * ahead + left * left
        range_m = np.sqrt(ground + up * up)
        bearing = -left / range_m
        along = (np.sqrt(ground) if ground_range else range_m) - near_m
        row = int(np.floor(along * bins_per_m))
        if ahead <= 0 or row < 0 or row >= rows or bearing < low or bearing >= high:
            continue
        guess = min(int((bearing - low) * beam_scale), first_beam.shape[0] - 1)
        beam = first_beam[guess]
        while beam + 1 < beams and bearing >= edges[beam + 1]:
            beam += 1
        turns = range_m * waves_per_m
        bin_of[count] = row * beams + beam
        root_of[count] = np.sqrt(power_of[slot])
        cell_of[count] = name
        phase_of[count] = np.uint16(int((turns - np.floor(turns)) * 65536.0) & 65535)
        count += 1
    return count


@compiled(
    "void(int32[::1], float32[::1], uint32[::1], uint16[::1], uint32, float32[:, ::1],"
    " float32[:, ::1], float32[:, ::1])"
)
def scatter_paths(
    bin_of: npt.NDArray[np.int32],
    root_of: Floats,
    cell_of: npt.NDArray[np.uint32],
    phase_of: npt.NDArray[np.uint16],
    key: int,
    table: Floats,
    turns: Floats,
    bins: Floats,
) -> None:
    """Add each cell's amplitude times its coefficient times exp(-2 i k r) to its bin.

    turns: (65536, 2) cosine and sine of the phases; bins: (bins, 2).
    """
    for at in range(bin_of.shape[0]):
        lot = mixed(np.uint32(cell_of[at] ^ key)) >> _16
        c, s = turns[phase_of[at], 0], turns[phase_of[at], 1]
        real, imaginary = root_of[at] * table[lot, 0], root_of[at] * table[lot, 1]
        bins[bin_of[at], 0] += real * c + imaginary * s
        bins[bin_of[at], 1] += imaginary * c - real * s


_1, _16 = np.uint32(1), np.uint32(16)
_ONE, _TWO, _THREE, _FOUR = np.float32(1), np.float32(2), np.float32(3), np.float32(4)
_BLOCK = 1024
# Weakest amplitude of the straight way that a mirrored one is compared with.
_FAINTEST = np.float32(1e-4)
_NEAREST_M = np.float32(1e-3)  # keeps directions finite


@compiled(
    "int64(int32[::1], Array(float32, 2, 'C', readonly=True), float32[::1], float32[::1],"
    " int32[::1], float32[:, ::1])"
)
def surface_points(
    owner: npt.NDArray[np.int32],
    depth_m: Floats,
    across: Floats,
    down: Floats,
    bins: npt.NDArray[np.int32],
    points_m: Floats,
) -> Any:
    """Bins that a pixel owns, and that pixel's point in camera axes; returns how many.

    owner, bins: (bins,).  points_m: (3, bins).
    """
    width, flat_m = np.int32(depth_m.shape[1]), depth_m.ravel()
    per_row = 1 / np.float64(width)
    xs, ys, zs = points_m[0], points_m[1], points_m[2]
    count = np.uint32(0)
    for i in range(owner.shape[0]):
        bins[count] = i
        count += np.uint32(owner[i] >= 0)
    for i in range(np.int64(count)):
        pixel = owner[np.uint32(bins[i])]
        row = np.int32((np.float64(pixel) + 0.5) * per_row)  # exact, and no division
        z = flat_m[np.uint32(pixel)]
        xs[i] = across[np.uint32(pixel - row * width)] * z
        ys[i] = down[np.uint32(row)] * z
        zs[i] = z
    return count


@compiled()
def _smooth(part: Any) -> Any:
    """0 to 1 as a step that begins and ends level."""
    return part * part * (_THREE - part - part)


@compiled("void(float32[:, ::1], float64[:, ::1], uint32, float32[:, ::1], float32[::1])")
def lattice(
    points_m: Floats,
    lattice_from_camera: npt.NDArray[np.float64],
    key: int,
    table: Floats,
    normal: Floats,
) -> None:
    """A standard normal field at (3, N) points, smooth over distances of 1 after (3, 4).

    Random values at the corners of unit cubes, weighted by smooth steps and brought back to unit
    variance.  table: (65536, 2) normal values of variance 1/2.
    """
    m = lattice_from_camera
    m00, m01, m02, m03 = m[0]
    m10, m11, m12, m13 = m[1]
    m20, m21, m22, m23 = m[2]
    us, vs = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    ws = np.empty(_BLOCK, np.float32)
    corners = np.empty(_BLOCK, np.uint32)
    places = np.empty((8, _BLOCK), np.uint32)
    # A block at a time: first what a processor does for many at once, then what must be looked up.
    for begin in range(0, points_m.shape[1], _BLOCK):
        size = min(_BLOCK, points_m.shape[1] - begin)
        first, second, third = (
            points_m[0, begin : begin + size],
            points_m[1, begin : begin + size],
            points_m[2, begin : begin + size],
        )
        for i in range(size):
            a, b, c = first[i], second[i], third[i]
            p = m00 * a + m01 * b + m02 * c + m03
            q = m10 * a + m11 * b + m12 * c + m13
            r = m20 * a + m21 * b + m22 * c + m23
            x, y, z = np.floor(p), np.floor(q), np.floor(r)
            us[i], vs[i], ws[i] = np.float32(p - x), np.float32(q - y), np.float32(r - z)
            corners[i] = lattice_sum(np.int32(x), np.int32(y), np.int32(z))
        for corner in range(8):
            away = np.uint32(
                np.uint32(corner & 1) * STEPS_X
                + np.uint32((corner >> 1) & 1) * STEPS_Y
                + np.uint32(corner >> 2) * STEPS_Z
            )
            drawn = places[corner]
            for i in range(size):
                drawn[i] = mixed(np.uint32(mixed(np.uint32(corners[i] + away)) ^ key)) >> _16
        made = normal[begin : begin + size]
        for i in range(size):
            u, v, w = _smooth(us[i]), _smooth(vs[i]), _smooth(ws[i])
            u_, v_, w_ = _ONE - u, _ONE - v, _ONE - w
            low = v_ * (u_ * table[places[0, i], 0] + u * table[places[1, i], 0])
            low += v * (u_ * table[places[2, i], 0] + u * table[places[3, i], 0])
            high = v_ * (u_ * table[places[4, i], 0] + u * table[places[5, i], 0])
            high += v * (u_ * table[places[6, i], 0] + u * table[places[7, i], 0])
            squares = (u * u + u_ * u_) * (v * v + v_ * v_) * (w * w + w_ * w_)
            made[i] = (w_ * low + w * high) * np.sqrt(_TWO / squares)


@compiled("void(float32[::1], Array(float32, 1, 'C', readonly=True), float32, float32[::1])")
def interpolated(at: Floats, table: Floats, reach: float, values: Floats) -> None:
    """Values of a table over equal steps from -reach to reach, linear in between, level beyond."""
    last = table.shape[0] - 1
    steps = np.float32(last / (2 * reach))
    for i in range(at.shape[0]):
        place = (min(max(at[i], -reach), reach) + reach) * steps
        step = np.uint32(min(np.int32(place), np.int32(last - 1)))
        part = place - np.float32(step)
        lower, upper = table[step], table[np.uint32(step + _1)]
        values[i] = lower + part * (upper - lower)


@compiled("void(int32[::1], float32[::1], float32[:, ::1])")
def strengthen(bins: npt.NDArray[np.int32], intensity: Floats, planes: Floats) -> None:
    """Multiply the amplitudes in some bins by roots of intensities; planes: (fields, bins)."""
    for plane in range(planes.shape[0]):
        made = planes[plane]
        for i in range(bins.shape[0]):
            made[np.uint32(bins[i])] *= np.sqrt(intensity[i])


@compiled(
    "void(int32[::1], float32[:, ::1], float32[:, ::1], float32[::1], float32, float32, float32,"
    " Array(float32, 1, 'C', readonly=True), float32, float32, float32, int64, int64,"
    " float32[::1], float32[:, ::1], float32[::1], float32[:, ::1])"
)
def mirror(
    sources: npt.NDArray[np.int32],
    points_m: Floats,
    rotation: Floats,
    position_m: Floats,
    height_m: float,
    cosine: float,
    sine: float,
    pattern: Floats,
    loss: float,
    nepers_per_m: float,
    bins_per_m: float,
    beams: int,
    bins: int,
    power: Floats,
    planes: Floats,
    power_out: Floats,
    planes_out: Floats,
) -> None:
    """Add to each bin what comes to it by way of a plane; see `noise.field.image_source`.

    sources: (M,) flat bins; points_m: (3, M) where they are, camera axes.  rotation, position_m:
    sonar axes from camera axes.  height_m: of the plane above the sonar; cosine, sine: of the
    sonar's tilt.  pattern: vertical intensity pattern at equal steps of sin(elevation) from -1 to
    1.  loss: intensity that one reflection leaves; nepers_per_m: absorption of intensity, one way.
    power: (bins,) intensities; planes: (fields, bins) amplitudes; ..._out: the same, added to, but
    power_out (0,) where all intensities are 0.
    """
    a0, a1, a2 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    b0, b1, b2 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    c0, c1, c2 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    px, py, pz = position_m[0], position_m[1], position_m[2]
    steps = np.float32((pattern.shape[0] - 1) / 2)
    r_of, longer_of = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    later_of, sine_of = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    image_of, once_of = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.float32)
    # What absorption leaves of the longer way, in steps of a range bin, linear in between.
    left = np.empty(2 * (bins // beams) + 2, np.float32)
    for step in range(left.shape[0]):
        left[step] = loss * np.exp(-nepers_per_m * np.float32(step) / bins_per_m)
    most = np.float32(left.shape[0] - 2)
    # A block at a time: first what a processor does for many at once, then what comes in time.
    for begin in range(0, sources.shape[0], _BLOCK):
        size = min(_BLOCK, sources.shape[0] - begin)
        first, second, third = (
            points_m[0, begin : begin + size],
            points_m[1, begin : begin + size],
            points_m[2, begin : begin + size],
        )
        for i in range(size):
            u, v, w = first[i] - px, second[i] - py, third[i] - pz
            x = a0 * u + a1 * v + a2 * w
            y = b0 * u + b1 * v + b2 * w
            z = c0 * u + c1 * v + c2 * w
            ahead, up = x * cosine + z * sine, z * cosine - x * sine
            up_image = _TWO * height_m - up
            flat2 = ahead * ahead + y * y
            r = max(np.sqrt(flat2 + up * up), _NEAREST_M)
            r_image = max(np.sqrt(flat2 + up_image * up_image), _NEAREST_M)
            r_of[i], longer_of[i], sine_of[i] = r, max(r_image - r, np.float32(0)), z / r
            # The direction of departure in the sonar's own axes.
            image_of[i] = (up_image * cosine + ahead * sine) / r_image
            later_of[i] = np.rint(longer_of[i] * bins_per_m / _TWO)
        for i in range(size):
            towards = pattern[np.uint32(np.int32(np.rint((image_of[i] + _ONE) * steps)))]
            straight = np.sqrt(pattern[np.uint32(np.int32(np.rint((sine_of[i] + _ONE) * steps)))])
            spread = r_of[i] / (r_of[i] + longer_of[i])
            away = min(longer_of[i] * bins_per_m, most)
            whole = np.int32(away)
            lower, upper = left[np.uint32(whole)], left[np.uint32(whole + 1)]
            once = np.sqrt(towards) / max(straight, _FAINTEST) * spread * spread
            once_of[i] = once * (lower + (away - np.float32(whole)) * (upper - lower))
        for i in range(size):
            source = np.int64(sources[begin + i])
            target = source + beams * np.int64(later_of[i])
            if target >= bins:
                continue
            once = once_of[i]
            amplitude = _TWO * np.sqrt(once)
            for plane in range(planes.shape[0]):
                planes_out[plane, np.uintp(target)] += amplitude * planes[plane, np.uintp(source)]
            if power_out.shape[0]:
                power_out[target] += _FOUR * once * power[source]
            twice = source + beams * np.int64(np.rint(longer_of[i] * bins_per_m))
            if twice < bins:
                for plane in range(planes.shape[0]):
                    planes_out[plane, np.uintp(twice)] += once * planes[plane, np.uintp(source)]
                if power_out.shape[0]:
                    power_out[twice] += once * once * power[source]
