"""Compiled z-buffers: which triangle every pixel of a camera, or of a map along the sun, meets.

A pixel is a ray, and a triangle is hit where the three products of the ray with the planes through
the eye and its edges have one sign (Olano & Greer 1997): no clipping, no gaps between triangles.
Rows of arrays are never cut out in the loops: counting references would take most of the time.
Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled

_NEAR_M = 0.02  # what is nearer to the lens is not seen
_ONE = np.float32(1)
# Of an index with a sign every access asks whether it is negative.
_U = np.uint64

POINTS = "Array(float32, 2, 'C', readonly=True)"
TRIANGLES = "Array(int32, 2, 'C', readonly=True)"
_PARTS = "int64[:, ::1]"


@compiled(
    f"void({POINTS}, {TRIANGLES}, {_PARTS}, int64, float64[::1], float64[:, ::1], float64[::1], "
    "float32[:, ::1], int32[:, ::1])"
)
def paint(
    points: Any,
    triangles: Any,
    parts: Any,
    offset: Any,
    eye: Any,
    axes: Any,
    lens: Any,
    inverse: Any,
    which: Any,
) -> None:
    """Paint parts of a mesh into the picture of a camera; triangle numbers begin at `offset`.

    parts: (N, 4) first point, first triangle and the ends of both.  eye: (3,).  axes: (3, 3) world
    from camera.  lens: (4,) fx, fy, cx, cy.  inverse: (H, W) one over the depth along the optical
    axis, 0 where nothing was met so far.  which: (H, W) number of the triangle met.
    """
    height, width = inverse.shape
    x_axis, y_axis, z_axis = (
        (axes[0, 0], axes[1, 0], axes[2, 0]),
        (axes[0, 1], axes[1, 1], axes[2, 1]),
        (axes[0, 2], axes[1, 2], axes[2, 2]),
    )
    fx, fy, middle_x, middle_y = lens[0], lens[1], lens[2], lens[3]
    step_x, step_y = 1 / fx, 1 / fy
    left_slope, right_slope = -middle_x * step_x, (width - 1 - middle_x) * step_x
    top_slope, bottom_slope = -middle_y * step_y, (height - 1 - middle_y) * step_y
    across_by_column = np.empty(width, np.float64)
    for column in range(width):
        across_by_column[column] = (column - middle_x) * step_x
    placed = np.empty((len(points), 3), np.float64)  # in camera axes
    seen = np.empty((len(points), 2), np.float32)  # column and row
    for part in range(len(parts)):
        for k in range(parts[part, 0], parts[part, 2]):
            x, y, z = points[k, 0] - eye[0], points[k, 1] - eye[1], points[k, 2] - eye[2]
            depth = z_axis[0] * x + z_axis[1] * y + z_axis[2] * z
            across = x_axis[0] * x + x_axis[1] * y + x_axis[2] * z
            down = y_axis[0] * x + y_axis[1] * y + y_axis[2] * z
            placed[k, 0], placed[k, 1], placed[k, 2] = across, down, depth
            over = 1 / max(depth, _NEAR_M)
            seen[k, 0] = across * over * fx + middle_x
            seen[k, 1] = down * over * fy + middle_y
        for k in range(parts[part, 1], parts[part, 3]):
            a, b, c = _U(triangles[k, 0]), _U(triangles[k, 1]), _U(triangles[k, 2])
            az, bz, cz = placed[a, 2], placed[b, 2], placed[c, 2]
            if min(az, bz, cz) > _NEAR_M:
                left = min(seen[a, 0], seen[b, 0], seen[c, 0])
                right = max(seen[a, 0], seen[b, 0], seen[c, 0])
                if left > width - 1 or right < 0:
                    continue
                first, last = max(int(np.ceil(left)), 0), min(int(np.floor(right)), width - 1)
                if first > last:
                    continue
                top = min(seen[a, 1], seen[b, 1], seen[c, 1])
                bottom = max(seen[a, 1], seen[b, 1], seen[c, 1])
                if top > height - 1 or bottom < 0:
                    continue
                upper, lower = max(int(np.ceil(top)), 0), min(int(np.floor(bottom)), height - 1)
                if upper > lower:
                    continue
            elif max(az, bz, cz) <= _NEAR_M:
                continue
            else:
                first, last, upper, lower = 0, width - 1, 0, height - 1
            ax, ay = placed[a, 0], placed[a, 1]
            bx, by = placed[b, 0], placed[b, 1]
            cx, cy = placed[c, 0], placed[c, 1]
            if last - first == width - 1 and (
                (ax < left_slope * az and bx < left_slope * bz and cx < left_slope * cz)
                or (ax > right_slope * az and bx > right_slope * bz and cx > right_slope * cz)
                or (ay < top_slope * az and by < top_slope * bz and cy < top_slope * cz)
                or (ay > bottom_slope * az and by > bottom_slope * bz and cy > bottom_slope * cz)
            ):
                continue  # it reaches behind the lens, but beside the picture
            ux, uy, uz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
            volume = ax * ux + ay * uy + az * uz
            if volume == 0:
                continue
            vx, vy, vz = cy * az - cz * ay, cz * ax - cx * az, cx * ay - cy * ax
            wx, wy, wz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            scale = 1 / volume
            for row in range(upper, lower + 1):
                y = (row - middle_y) * step_y
                u0, v0, w0 = uy * y + uz, vy * y + vz, wy * y + wz
                here = _U(row)
                for column in range(_U(first), _U(last + 1)):
                    x = across_by_column[column]
                    u, v, w = (ux * x + u0) * scale, (vx * x + v0) * scale, (wx * x + w0) * scale
                    if u >= 0 and v >= 0 and w >= 0:
                        near = np.float32(u + v + w)
                        if near > inverse[here, column]:
                            inverse[here, column] = near
                            which[here, column] = offset + k


@compiled(
    f"void({POINTS}, {TRIANGLES}, {_PARTS}, float32[::1], float32[::1], int64, float32[:, ::1])"
)
def cover(
    points: Any, triangles: Any, parts: Any, slope: Any, place: Any, turn: Any, tops: Any
) -> None:
    """Draw parts of a mesh into a map of the greatest heights that the sun's light meets.

    parts: as for `paint`.  slope: (2,) metres that light moves across in a metre of height.
    place: (3,) metres where the map begins, in x and y at height 0, and cells a metre.
    turn: only triangles that turn this way as the sun sees them, 1 or -1; 0: all.  tops: (S, S).
    """
    side = tops.shape[0]
    scale = place[2]
    placed = np.empty((len(points), 2), np.float32)
    for part in range(len(parts)):
        for k in range(parts[part, 0], parts[part, 2]):
            placed[k, 0] = (points[k, 0] - points[k, 2] * slope[0] - place[0]) * scale
            placed[k, 1] = (points[k, 1] - points[k, 2] * slope[1] - place[1]) * scale
        for k in range(parts[part, 1], parts[part, 3]):
            a, b, c = triangles[k, 0], triangles[k, 1], triangles[k, 2]
            ax, bx, cx = placed[a, 0], placed[b, 0], placed[c, 0]
            left, right = min(ax, bx, cx), max(ax, bx, cx)
            if left > side - 1 or right < 0:
                continue
            first, last = max(int(np.ceil(left)), 0), min(int(np.floor(right)), side - 1)
            if first > last:
                continue
            ay, by, cy = placed[a, 1], placed[b, 1], placed[c, 1]
            top, bottom = min(ay, by, cy), max(ay, by, cy)
            if top > side - 1 or bottom < 0:
                continue
            upper, lower = max(int(np.ceil(top)), 0), min(int(np.floor(bottom)), side - 1)
            if upper > lower:
                continue
            bx, by, cx, cy = bx - ax, by - ay, cx - ax, cy - ay
            area = bx * cy - by * cx
            if area == 0 or area * turn < 0:
                continue
            over = _ONE / area
            az, bz, cz = points[a, 2], points[b, 2], points[c, 2]
            for row in range(upper, lower + 1):
                y = np.float32(row) - ay
                for column in range(first, last + 1):
                    x = np.float32(column) - ax
                    v, w = (x * cy - y * cx) * over, (y * bx - x * by) * over
                    u = _ONE - v - w
                    if u >= 0 and v >= 0 and w >= 0:
                        height = az * u + bz * v + cz * w
                        if height > tops[row, column]:
                            tops[row, column] = height
