"""Compiled loops over cells of the world as scatterers with a place; see `factory.compiled`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ....compiled import compiled
from ..kernels import mixed
from .cell_loops import lattice_sum

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]

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
def scatter(
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
