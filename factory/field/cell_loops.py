"""Compiled loops over the cells of the world in which scatterers lie; see `factory.compiled`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from factory.compiled import compiled
from factory.field.kernels import mixed

Floats = npt.NDArray[np.float32]

STEPS_X, STEPS_Y, STEPS_Z = np.uint32(73856093), np.uint32(19349663), np.uint32(83492791)
_0, _1 = np.uint32(0), np.uint32(1)
_BLOCK = 1024


@compiled()
def lattice_sum(x: Any, y: Any, z: Any) -> Any:
    """32 bits for a cube of a lattice, given by three whole numbers of any sign; not yet mixed."""
    first, second, third = np.uint32(np.int64(x)), np.uint32(np.int64(y)), np.uint32(np.int64(z))
    return np.uint32(first * STEPS_X + second * STEPS_Y + third * STEPS_Z)


@compiled(
    "void(int32[::1], float32[::1], Array(float32, 2, 'C', readonly=True), float32[::1],"
    " float32[::1], float64[:, ::1], float64, uint32[::1])"
)
def cells(
    pixels: npt.NDArray[np.int32],
    parts: Floats,
    depth_m: Floats,
    across: Floats,
    down: Floats,
    world_from_camera: npt.NDArray[np.float64],
    cell_m: float,
    cell_of: npt.NDArray[np.uint32],
) -> None:
    """Number (hash) of the world cell, a cube of edge `cell_m`, in which each scatterer lies.

    pixels, parts: as `placing.place` gives them; pixels never decrease.
    """
    height, width = depth_m.shape
    m = world_from_camera / cell_m
    m00, m01, m02, m03 = m[0]
    m10, m11, m12, m13 = m[1]
    m20, m21, m22, m23 = m[2]
    xs, ys, zs = np.empty(_BLOCK), np.empty(_BLOCK), np.empty(_BLOCK)
    row = 0
    # A block at a time: first what must be looked up, then what a processor does for many at once.
    for begin in range(0, pixels.shape[0], _BLOCK):
        size = min(_BLOCK, pixels.shape[0] - begin)
        for i in range(size):
            pixel = pixels[begin + i]
            while pixel >= (row + 1) * width:
                row += 1
            column = pixel - row * width
            below = min(row + 1, height - 1)
            z = np.float64(depth_m[row, column])
            y = down[row] * z
            z_below = np.float64(depth_m[below, column])
            part = np.float64(parts[begin + i])
            ys[i] = y + part * (down[below] * z_below - y)
            zs[i] = z + part * (z_below - z)
            xs[i] = across[column] * zs[i]
        numbers = cell_of[begin : begin + size]
        for i in range(size):
            x, y, z = xs[i], ys[i], zs[i]
            first = np.floor(m00 * x + m01 * y + m02 * z + m03)
            second = np.floor(m10 * x + m11 * y + m12 * z + m13)
            third = np.floor(m20 * x + m21 * y + m22 * z + m23)
            numbers[i] = mixed(lattice_sum(first, second, third))


@compiled("int64(uint32[::1], uint32[::1], int32[::1], int32[::1])")
def runs(
    cell_of: npt.NDArray[np.uint32],
    name_of: npt.NDArray[np.uint32],
    end_of: npt.NDArray[np.int32],
    run_of: npt.NDArray[np.int32],
) -> Any:
    """Neighbours in the same cell, taken together; returns how many such runs there are.

    run_of: (points,) out, the run of each.  name_of, end_of: (at least points,) out, the cell of
    each run and the point behind its last.
    """
    run, last = np.int64(-1), ~cell_of[0]
    for i in range(cell_of.shape[0]):
        name = cell_of[i]
        run += np.int64(name != last)
        last = name
        at = np.uint32(run)
        name_of[at] = name
        end_of[at] = i + 1
        run_of[i] = run
    return run + 1


@compiled("uint32(uint32[::1], int32[::1], uint32[:, ::1], int32[::1])")
def count(
    name_of: npt.NDArray[np.uint32],
    end_of: npt.NDArray[np.int32],
    table: npt.NDArray[np.uint32],
    many_of: npt.NDArray[np.int32],
) -> Any:
    """How many points the cell of each run has, in all of its runs together.

    name_of, end_of: as `runs` gives them; many_of: (runs,) out.  table: (slots, 2) zeros, slots a
    power of two and more than there are runs.  What it returns means nothing.
    """
    mask = np.uint32(table.shape[0] - 1)
    begin: Any = np.int32(0)
    touched: Any = np.uint32(0)
    for first in range(0, name_of.shape[0], _BLOCK):
        last = min(first + _BLOCK, name_of.shape[0])
        # Once through without a branch, so that the memory fetches many slots at the same time.
        for at in range(first, last):
            touched ^= table[name_of[np.uint32(at)] & mask, 0]
        for at in range(first, last):
            run = np.uint32(at)
            name = name_of[run]
            slot = name & mask
            # Not `and`: whether a cell is new cannot be foretold, and a wrong guess costs much.
            while (table[slot, 1] != _0) & (table[slot, 0] != name):
                slot = np.uint32(slot + _1) & mask
            table[slot, 0] = name
            table[slot, 1] += np.uint32(end_of[run] - begin)
            begin = end_of[run]
            many_of[run] = slot
    for at in range(name_of.shape[0]):
        many_of[at] = table[np.uint32(many_of[at]), 1]
    return touched


@compiled("void(int32[::1], int32[::1], float32[::1], float32[::1])")
def share(
    run_of: npt.NDArray[np.int32],
    many_of: npt.NDArray[np.int32],
    power_of: Floats,
    amplitude_of: Floats,
) -> None:
    """Amplitude of each point, sqrt(power / points of its cell): they add up coherently."""
    for i in range(run_of.shape[0]):
        many = np.float32(many_of[np.uint32(run_of[i])])
        amplitude_of[i] = np.sqrt(power_of[i] / many)
