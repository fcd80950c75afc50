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
    """A point in a camera's axes: across, down, ahead."""
    x = point[0] - eye[0]
    y = point[1] - eye[1]
    z = point[2] - eye[2]
    return (
        axes[0, 0] * x + axes[1, 0] * y + axes[2, 0] * z,
        axes[0, 1] * x + axes[1, 1] * y + axes[2, 1] * z,
        axes[0, 2] * x + axes[1, 2] * y + axes[2, 2] * z,
    )


@compiled()
def _pixel_box(first: Any, second: Any, third: Any, width: Any, height: Any) -> Any:
    """First and last column, first and last row of the pixels inside the box of three corners.

    The corners are columns and rows with fractions.  Without any pixel the first exceeds the last.
    """
    left = min(first[0], second[0], third[0])
    right = max(first[0], second[0], third[0])
    top = min(first[1], second[1], third[1])
    bottom = max(first[1], second[1], third[1])
    # Asked before rounding, for what lies far outside exceeds the whole numbers.
    if left > width - 1 or right < 0 or top > height - 1 or bottom < 0:
        return 1, 0, 1, 0
    return (
        max(int(np.ceil(left)), 0),
        min(int(np.floor(right)), width - 1),
        max(int(np.ceil(top)), 0),
        min(int(np.floor(bottom)), height - 1),
    )


@compiled()
def _is_beside_image(first: Any, second: Any, third: Any, slopes: Any) -> Any:
    """Whether three corners in camera axes lie beyond one side of the image, all of them.

    slopes: across over ahead at the left and right border, down over ahead at the top and bottom.
    """
    left, right, top, bottom = slopes
    ax, ay, az = first
    bx, by, bz = second
    cx, cy, cz = third
    return (
        (ax < left * az and bx < left * bz and cx < left * cz)
        or (ax > right * az and bx > right * bz and cx > right * cz)
        or (ay < top * az and by < top * bz and cy < top * cz)
        or (ay > bottom * az and by > bottom * bz and cy > bottom * cz)
    )


@compiled()
def _cross(first: Any, second: Any) -> Any:
    """The cross product of two vectors."""
    return (
        first[1] * second[2] - second[1] * first[2],
        first[2] * second[0] - second[2] * first[0],
        first[0] * second[1] - second[0] * first[1],
    )


@compiled(f"void({_ROWS}, {_WHOLES}, int64[:, ::1], int64, {_CAMERA}, {_SEEN})")
def rasterise_mesh(
    points: Any, triangles: Any, parts: Any, offset: Any, camera: Any, planes: Any
) -> None:
    """Paint parts of a mesh into the image of a camera; triangle numbers begin at `offset`.

    A pixel's ray meets a triangle where its three barycentric weights are not negative; they are
    linear in the ray, and their sum is one over the depth (Olano and Greer 1997).

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
    slopes = (
        -middle_x * step_x,
        (width - 1 - middle_x) * step_x,
        -middle_y * step_y,
        (height - 1 - middle_y) * step_y,
    )
    across_by_column = (np.arange(width) - middle_x) * step_x
    in_view = np.empty((len(points), 3), np.float64)  # in camera axes
    pixels = np.empty((len(points), 2), np.float32)  # column and row
    for part in range(len(parts)):
        for k in range(parts[part, 0], parts[part, 2]):
            across, down, depth = in_camera_axes(points[k], eye, axes)
            in_view[k, 0] = across
            in_view[k, 1] = down
            in_view[k, 2] = depth
            over = 1 / max(depth, _NEAR_M)
            pixels[k, 0] = across * over * fx + middle_x
            pixels[k, 1] = down * over * fy + middle_y
        for k in range(parts[part, 1], parts[part, 3]):
            a = _U(triangles[k, 0])
            b = _U(triangles[k, 1])
            c = _U(triangles[k, 2])
            first_corner = (in_view[a, 0], in_view[a, 1], in_view[a, 2])
            second_corner = (in_view[b, 0], in_view[b, 1], in_view[b, 2])
            third_corner = (in_view[c, 0], in_view[c, 1], in_view[c, 2])
            if max(first_corner[2], second_corner[2], third_corner[2]) <= _NEAR_M:
                continue
            first = 0
            last = width - 1
            upper = 0
            lower = height - 1
            if min(first_corner[2], second_corner[2], third_corner[2]) > _NEAR_M:
                first, last, upper, lower = _pixel_box(
                    pixels[a], pixels[b], pixels[c], width, height
                )
                if first > last or upper > lower:
                    continue
            # A triangle that reaches behind the lens may still lie beside the image.
            if last - first == width - 1 and _is_beside_image(
                first_corner, second_corner, third_corner, slopes
            ):
                continue
            ux, uy, uz = _cross(second_corner, third_corner)
            volume = first_corner[0] * ux + first_corner[1] * uy + first_corner[2] * uz
            if volume == 0:
                continue
            vx, vy, vz = _cross(third_corner, first_corner)
            wx, wy, wz = _cross(first_corner, second_corner)
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
