"""Compiled loops over the cells of the world in which scatterers lie; see `factory.compiled`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ....compiled import compiled
from ..kernels import mixed

Floats = npt.NDArray[np.float32]

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
