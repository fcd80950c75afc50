"""Compiled loops over scatterers and over the bins of a polar field; see `factory.compiled`.

A field is (looks, 2, range_bins, beams) float32: real and imaginary parts as planes of their own,
so that whatever mixes beams or ranges treats them as plain numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from factory.compiled import compiled

Floats = npt.NDArray[np.float32]

_A, _B = np.uint32(0x85EBCA6B), np.uint32(0xC2B2AE35)
_X, _Y, _Z = np.int64(73856093), np.int64(19349663), np.int64(83492791)
_13, _16 = np.uint32(13), np.uint32(16)


@compiled()
def mixed(word: Any) -> Any:
    """32 bits -> 32 bits that look random: the finaliser of MurmurHash3 (public domain)."""
    word = np.uint32(word ^ (word >> _16))
    word = np.uint32(word * _A)
    word = np.uint32(word ^ (word >> _13))
    word = np.uint32(word * _B)
    return np.uint32(word ^ (word >> _16))


@compiled()
def cube(first: Any, second: Any, third: Any) -> Any:
    """32 bits that stand for a cube of a lattice, given by three integers of any sign."""
    word = first * _X + second * _Y + third * _Z
    return mixed(np.uint32(word & 0xFFFFFFFF))


@compiled("void(int32[::1], uint32[::1], float32[::1], uint32, float32[:, ::1], float32[:, ::1])")
def scatter(
    bin_of: npt.NDArray[np.int32],
    cell_of: npt.NDArray[np.uint32],
    amplitude_of: Floats,
    key: int,
    table: Floats,
    planes: Floats,
) -> None:
    """Add each point's amplitude times its cell's coefficient to its bin; planes is (2, bins)."""
    for i in range(bin_of.shape[0]):
        drawn = mixed(np.uint32(cell_of[i] ^ key)) >> _16
        planes[0, bin_of[i]] += amplitude_of[i] * table[drawn, 0]
        planes[1, bin_of[i]] += amplitude_of[i] * table[drawn, 1]


@compiled("void(float32[:, ::1], float32[::1], float32[:, ::1])")
def along_range(planes: Floats, kernel: Floats, out: Floats) -> None:
    """Correlate the rows of (rows, n) with `kernel`; nothing comes from beyond the ends."""
    rows, width = planes.shape
    half = kernel.shape[0] // 2
    for row in range(rows):
        for column in range(width):
            out[row, column] = 0
        for tap in range(kernel.shape[0]):
            source = row + tap - half
            if 0 <= source < rows:
                weight = kernel[tap]
                for column in range(width):
                    out[row, column] += weight * planes[source, column]


@compiled("void(float32[:, ::1], float32[:, ::1], float32[:, ::1])")
def across_beams(planes: Floats, mixing: Floats, out: Floats) -> None:
    """(n, beams) times (beams, beams), four rows at a time; the order of the sums is fixed."""
    rows, beams = planes.shape
    whole = rows - rows % 4
    for row in range(0, whole, 4):
        for beam in range(beams):
            out[row, beam] = 0
            out[row + 1, beam] = 0
            out[row + 2, beam] = 0
            out[row + 3, beam] = 0
        for source in range(beams):
            a, b = planes[row, source], planes[row + 1, source]
            c, d = planes[row + 2, source], planes[row + 3, source]
            if a == 0 and b == 0 and c == 0 and d == 0:
                continue
            for beam in range(beams):
                weight = mixing[source, beam]
                out[row, beam] += a * weight
                out[row + 1, beam] += b * weight
                out[row + 2, beam] += c * weight
                out[row + 3, beam] += d * weight
    for row in range(whole, rows):
        for beam in range(beams):
            out[row, beam] = 0
        for source in range(beams):
            a = planes[row, source]
            for beam in range(beams):
                out[row, beam] += a * mixing[source, beam]


@compiled("void(uint32, float32[:, ::1], float32[:, ::1])")
def white(key: int, table: Floats, planes: Floats) -> None:
    """Fill (2, n) with complex circular noise of power 1, a function of the key and the place."""
    for i in range(planes.shape[1]):
        drawn = mixed(np.uint32(mixed(np.uint32(i)) ^ key)) >> _16
        planes[0, i] = table[drawn, 0]
        planes[1, i] = table[drawn, 1]


@compiled("void(float64[:, ::1], uint32, float32[:, ::1], float32[::1])")
def lattice(points: npt.NDArray[np.float64], key: int, table: Floats, normal: Floats) -> None:
    """A standard normal field at (N, 3) points, smooth over distances of 1.

    Random values at the corners of unit cubes, weighted by smooth steps and brought back to unit
    variance.  table: (65536, 2) normal values of variance 1/2.
    """
    for i in range(points.shape[0]):
        x, y, z = np.floor(points[i, 0]), np.floor(points[i, 1]), np.floor(points[i, 2])
        u, v, w = points[i, 0] - x, points[i, 1] - y, points[i, 2] - z
        u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
        at_x, at_y, at_z = np.int64(x), np.int64(y), np.int64(z)
        total, squares = 0.0, 0.0
        for corner in range(8):
            p, q, r = corner & 1, (corner >> 1) & 1, corner >> 2
            weight = (u if p else 1 - u) * (v if q else 1 - v) * (w if r else 1 - w)
            name = mixed(np.uint32(cube(at_x + p, at_y + q, at_z + r) ^ key))
            total += weight * table[name >> _16, 0]
            squares += weight * weight
        normal[i] = np.float32(total * np.sqrt(2 / squares))


@compiled(
    "void(Array(int64, 1, 'C', readonly=True), float32[::1], float32[::1], int64,"
    " Array(float32, 2, 'C', readonly=True), float32[:, ::1])"
)
def mirror(
    sources: npt.NDArray[np.intp],
    longer_bins: Floats,
    once: Floats,
    beams: int,
    planes: Floats,
    out: Floats,
) -> None:
    """Add to each bin what comes to it by way of a plane; see `noise.physical.image_source`.

    sources: (M,) flat bins.  longer_bins: how many bins farther the mirrored way there is; half of
    that by way of the plane once.  once: (M,) intensity of one reflection.
    planes: (1 + fields, bins), intensity first, then amplitudes; out: the same, added to.
    """
    bins = planes.shape[1]
    for i in range(sources.shape[0]):
        source = sources[i]
        for touches in range(1, 3):
            target = source + beams * int(np.rint(longer_bins[i] * touches / 2))
            if target >= bins:
                continue
            gain = 4 * once[i] if touches == 1 else once[i] * once[i]
            out[0, target] += gain * planes[0, source]
            amplitude = np.sqrt(gain)
            for plane in range(1, planes.shape[0]):
                out[plane, target] += amplitude * planes[plane, source]
