"""Compiled loops over the surface that fills the bins; see `factory.compiled`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from factory.compiled import compiled
from factory.field.cell_loops import STEPS_X, STEPS_Y, STEPS_Z, lattice_sum
from factory.field.kernels import mixed

Floats = npt.NDArray[np.float32]

_1, _16 = np.uint32(1), np.uint32(16)
_ONE, _TWO, _THREE = np.float32(1), np.float32(2), np.float32(3)
_BLOCK = 1024
# Weakest amplitude of the straight way that a mirrored one is compared with.
_FAINTEST = np.float32(1e-4)


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

    owner, bins: (bins,).  points_m: (bins, 3).
    """
    width = np.int32(depth_m.shape[1])
    per_row = 1 / np.float64(width)
    count = np.uint32(0)
    for i in range(owner.shape[0]):
        bins[count] = i
        count += np.uint32(owner[i] >= 0)
    for i in range(count):
        pixel = owner[np.uint32(bins[i])]
        row = np.uint32((np.float64(pixel) + 0.5) * per_row)  # exact, and no division
        column = np.uint32(pixel - np.int32(row) * width)
        z = depth_m[row, column]
        points_m[i, 0] = across[column] * z
        points_m[i, 1] = down[row] * z
        points_m[i, 2] = z
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
    """A standard normal field at (N, 3) points, smooth over distances of 1 after (3, 4).

    Random values at the corners of unit cubes, weighted by smooth steps and brought back to unit
    variance.  table: (65536, 2) normal values of variance 1/2.
    """
    m = lattice_from_camera
    m00, m01, m02, m03 = m[0]
    m10, m11, m12, m13 = m[1]
    m20, m21, m22, m23 = m[2]
    parts = np.empty((3, _BLOCK), np.float32)
    us, vs, ws = parts
    corners = np.empty(_BLOCK, np.uint32)
    places = np.empty((8, _BLOCK), np.uint32)
    # A block at a time: first what a processor does for many at once, then what must be looked up.
    for begin in range(0, points_m.shape[0], _BLOCK):
        size = min(_BLOCK, points_m.shape[0] - begin)
        for i in range(size):
            a, b, c = points_m[begin + i, 0], points_m[begin + i, 1], points_m[begin + i, 2]
            p = m00 * a + m01 * b + m02 * c + m03
            q = m10 * a + m11 * b + m12 * c + m13
            r = m20 * a + m21 * b + m22 * c + m23
            x, y, z = np.floor(p), np.floor(q), np.floor(r)
            us[i], vs[i], ws[i] = np.float32(p - x), np.float32(q - y), np.float32(r - z)
            corners[i] = lattice_sum(x, y, z)
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


@compiled()
def _reflect(
    source: Any,
    target: Any,
    gain: Any,
    power: Floats,
    planes: Floats,
    power_out: Floats,
    planes_out: Floats,
) -> None:
    power_out[target] += gain * power[source]
    amplitude = np.sqrt(gain)
    for plane in range(planes.shape[0]):
        planes_out[plane, target] += amplitude * planes[plane, source]


@compiled(
    "void(int32[::1], float32[:, ::1], float32[:, ::1], float32[::1], float32, float32, float32,"
    " Array(float32, 1, 'C', readonly=True), float32, float32, float32, int64, float32[::1],"
    " float32[:, ::1], float32[::1], float32[:, ::1])"
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
    power: Floats,
    planes: Floats,
    power_out: Floats,
    planes_out: Floats,
) -> None:
    """Add to each bin what comes to it by way of a plane; see `noise.physical.image_source`.

    sources: (M,) flat bins; points_m: (M, 3) where they are, camera axes.  rotation, position_m:
    sonar axes from camera axes.  height_m: of the plane above the sonar; cosine, sine: of the
    sonar's tilt.  pattern: vertical intensity pattern at equal steps of sin(elevation) from -1 to
    1.  loss: intensity that one reflection leaves; nepers_per_m: absorption of intensity, one way.
    power: (bins,) intensities; planes: (fields, bins) amplitudes; ..._out: the same, added to.
    """
    bins = power.shape[0]
    a0, a1, a2 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    b0, b1, b2 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    c0, c1, c2 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    px, py, pz = position_m[0], position_m[1], position_m[2]
    steps = np.float32((pattern.shape[0] - 1) / 2)
    r_of, longer_of, later_of, sine_of, image_of = np.empty((5, _BLOCK), np.float32)
    # A block at a time: first what a processor does for many at once, then what comes in time.
    for begin in range(0, sources.shape[0], _BLOCK):
        size = min(_BLOCK, sources.shape[0] - begin)
        for i in range(size):
            at = begin + i
            u, v, w = points_m[at, 0] - px, points_m[at, 1] - py, points_m[at, 2] - pz
            x = a0 * u + a1 * v + a2 * w
            y = b0 * u + b1 * v + b2 * w
            z = c0 * u + c1 * v + c2 * w
            ahead, up = x * cosine + z * sine, z * cosine - x * sine
            up_image = _TWO * height_m - up
            flat2 = ahead * ahead + y * y
            r, r_image = np.sqrt(flat2 + up * up), np.sqrt(flat2 + up_image * up_image)
            r_of[i], longer_of[i], sine_of[i] = r, max(r_image - r, np.float32(0)), z / r
            # The direction of departure in the sonar's own axes.
            image_of[i] = (up_image * cosine + ahead * sine) / r_image
            later_of[i] = np.rint(longer_of[i] * bins_per_m / _TWO)
        for i in range(size):
            source = sources[begin + i]
            target = source + beams * int(later_of[i])
            if target >= bins:
                continue
            towards = pattern[int(np.rint((image_of[i] + _ONE) * steps))]
            straight = np.sqrt(pattern[int(np.rint((sine_of[i] + _ONE) * steps))])
            spread = r_of[i] / (r_of[i] + longer_of[i])
            once = np.sqrt(towards) / max(straight, _FAINTEST) * spread * spread
            once *= loss * np.exp(-nepers_per_m * longer_of[i])
            _reflect(source, target, 4 * once, power, planes, power_out, planes_out)
            twice = source + beams * int(np.rint(longer_of[i] * bins_per_m))
            if twice < bins:
                _reflect(source, twice, once * once, power, planes, power_out, planes_out)
