"""Compiled loops of meshes: sums of waves, and the z-buffer of a camera.

Imported where it is used: see `simnfnd.factory.common.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...common.compiled import compiled
from ...common.elementary import sine_of_turns

_F = np.float32
_ZERO = _F(0)
_TURNS = _F(1 / (2 * np.pi))
_BLOCK = 1024
_NEAR_M = 0.02  # what is nearer to the lens is not seen
# Of an index with a sign every access asks whether it is negative.
_U = np.uint64

_LINE, _ROWS = (f"Array(float32, {n}, 'C', readonly=True)" for n in (1, 2))
_WHOLES = "Array(int32, 2, 'C', readonly=True)"
_CAMERA = "Tuple((float64[::1], float64[:, ::1], float64[::1]))"
_SEEN = "Tuple((float32[:, ::1], int32[:, ::1]))"


@compiled(f"float32[::1]({_ROWS}, {_ROWS}, {_LINE}, {_LINE})")
def sum_waves(axes: Any, vectors: Any, phases: Any, amplitudes: Any) -> Any:
    """(N,) sum of the waves at `axes` (D, N), D of 2 or 3.

    vectors: (K, D) rad/m.  phases, amplitudes: (K,).
    """
    total = np.zeros(axes.shape[1], np.float32)
    for begin in range(0, axes.shape[1], _BLOCK):
        # Cut out, so that the compiler sees that no index is negative, and does several at a time.
        x = axes[0, begin : begin + _BLOCK]
        y = axes[1, begin : begin + _BLOCK]
        z = axes[axes.shape[0] - 1, begin : begin + _BLOCK]
        part = total[begin : begin + _BLOCK]
        for k in range(len(phases)):
            start = phases[k] * _TURNS
            height = amplitudes[k]
            a, b = vectors[k, 0] * _TURNS, vectors[k, 1] * _TURNS
            c = vectors[k, 2] * _TURNS if axes.shape[0] == 3 else _ZERO
            for i in range(len(part)):
                part[i] += height * sine_of_turns(start + a * x[i] + b * y[i] + c * z[i])
    return total


@compiled()
def in_camera_axes(point: Any, eye: Any, axes: Any) -> Any:
    """A point in a camera's own axes: across, down, ahead."""
    x = point[0] - eye[0]
    y = point[1] - eye[1]
    z = point[2] - eye[2]
    return (
        axes[0, 0] * x + axes[1, 0] * y + axes[2, 0] * z,
        axes[0, 1] * x + axes[1, 1] * y + axes[2, 1] * z,
        axes[0, 2] * x + axes[1, 2] * y + axes[2, 2] * z,
    )


@compiled(f"void({_ROWS}, {_WHOLES}, int64[:, ::1], int64, {_CAMERA}, {_SEEN})")
def rasterise_mesh(
    points: Any, triangles: Any, parts: Any, offset: Any, camera: Any, planes: Any
) -> None:
    """Paint parts of a mesh into the image of a camera; triangle numbers begin at `offset`.

    parts: (N, 4) first point, first triangle and the ends of both.  camera: eye (3,), axes (3, 3)
    world from camera, lens (4,) fx, fy, cx, cy.  planes: (H, W) one over the depth along the
    optical axis, 0 where nothing was met so far, and (H, W) number of the triangle met.
    """
    eye, axes, lens = camera
    inverse, which = planes
    height, width = inverse.shape
    fx = lens[0]
    fy = lens[1]
    middle_x = lens[2]
    middle_y = lens[3]
    step_x = 1 / fx
    step_y = 1 / fy
    left_slope = -middle_x * step_x
    right_slope = (width - 1 - middle_x) * step_x
    top_slope = -middle_y * step_y
    bottom_slope = (height - 1 - middle_y) * step_y
    across_by_column = (np.arange(width) - middle_x) * step_x
    placed = np.empty((len(points), 3), np.float64)  # in camera axes
    pixels = np.empty((len(points), 2), np.float32)  # column and row
    for part in range(len(parts)):
        for k in range(parts[part, 0], parts[part, 2]):
            across, down, depth = in_camera_axes(points[k], eye, axes)
            placed[k, 0] = across
            placed[k, 1] = down
            placed[k, 2] = depth
            over = 1 / max(depth, _NEAR_M)
            pixels[k, 0] = across * over * fx + middle_x
            pixels[k, 1] = down * over * fy + middle_y
        for k in range(parts[part, 1], parts[part, 3]):
            a = _U(triangles[k, 0])
            b = _U(triangles[k, 1])
            c = _U(triangles[k, 2])
            az = placed[a, 2]
            bz = placed[b, 2]
            cz = placed[c, 2]
            if min(az, bz, cz) > _NEAR_M:
                left = min(pixels[a, 0], pixels[b, 0], pixels[c, 0])
                right = max(pixels[a, 0], pixels[b, 0], pixels[c, 0])
                top = min(pixels[a, 1], pixels[b, 1], pixels[c, 1])
                bottom = max(pixels[a, 1], pixels[b, 1], pixels[c, 1])
                if left > width - 1 or right < 0 or top > height - 1 or bottom < 0:
                    continue
                first = max(int(np.ceil(left)), 0)
                last = min(int(np.floor(right)), width - 1)
                upper = max(int(np.ceil(top)), 0)
                lower = min(int(np.floor(bottom)), height - 1)
                if first > last or upper > lower:
                    continue
            elif max(az, bz, cz) <= _NEAR_M:
                continue
            else:
                first = 0
                last = width - 1
                upper = 0
                lower = height - 1
            ax = placed[a, 0]
            bx = placed[b, 0]
            cx = placed[c, 0]
            ay = placed[a, 1]
            by = placed[b, 1]
            cy = placed[c, 1]
            if last - first == width - 1 and (
                (ax < left_slope * az and bx < left_slope * bz and cx < left_slope * cz)
                or (ax > right_slope * az and bx > right_slope * bz and cx > right_slope * cz)
                or (ay < top_slope * az and by < top_slope * bz and cy < top_slope * cz)
                or (ay > bottom_slope * az and by > bottom_slope * bz and cy > bottom_slope * cz)
            ):
                continue  # it reaches behind the lens, but beside the image
            ux = by * cz - bz * cy
            uy = bz * cx - bx * cz
            uz = bx * cy - by * cx
            volume = ax * ux + ay * uy + az * uz
            if volume == 0:
                continue
            vx = cy * az - cz * ay
            vy = cz * ax - cx * az
            vz = cx * ay - cy * ax
            wx = ay * bz - az * by
            wy = az * bx - ax * bz
            wz = ax * by - ay * bx
            scale = 1 / volume
            for row in range(upper, lower + 1):
                y = (row - middle_y) * step_y
                u0 = uy * y + uz
                v0 = vy * y + vz
                w0 = wy * y + wz
                pixel_row = _U(row)
                for column in range(_U(first), _U(last + 1)):
                    x = across_by_column[column]
                    u = (ux * x + u0) * scale
                    v = (vx * x + v0) * scale
                    w = (wx * x + w0) * scale
                    if u >= 0 and v >= 0 and w >= 0:
                        near = np.float32(u + v + w)
                        if near > inverse[pixel_row, column]:
                            inverse[pixel_row, column] = near
                            which[pixel_row, column] = offset + k
