"""Compiled loops over the surface that fills the bins; see `simnfnd.factory.compiled`."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ....compiled import compiled
from ..kernels import mixed
from .cell_loops import STEPS_X, STEPS_Y, STEPS_Z, lattice_sum

Floats = npt.NDArray[np.float32]

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
