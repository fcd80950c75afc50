"""Compiled loops over the pixels of a view: what they meet, and how much light gets there.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled
from .raster_loops import POINTS, TRIANGLES

_F = np.float32
_STEPS = (0.12, 0.3, 0.6, 1.0)  # along a ray that looks for what is near
_OWNERS = "Array(uint16, 1, 'C', readonly=True)"
_PLANE, _VECTORS = "float32[:, ::1]", "float32[:, :, ::1]"


@compiled(
    f"void({POINTS}, {POINTS}, {POINTS}, int64, {POINTS}, {POINTS}, {POINTS}, {TRIANGLES}, "
    f"{_OWNERS}, float64[::1], float64[:, ::1], float64[::1], {_PLANE}, int32[:, ::1], "
    f"{_PLANE}, {_VECTORS}, {_VECTORS}, uint16[:, ::1])"
)
def meet(
    ground: Any,
    ground_normals: Any,
    attributes: Any,
    columns: Any,
    points: Any,
    point_normals: Any,
    colours: Any,
    triangles: Any,
    owners: Any,
    eye: Any,
    axes: Any,
    lens: Any,
    inverse: Any,
    which: Any,
    depth_m: Any,
    normals: Any,
    base: Any,
    owner: Any,
) -> None:
    """Surface at every pixel, from the triangles that a z-buffer found.

    Written: depth_m (H, W), inf where nothing is; normals (H, W, 3); base (H, W, 3), the ground's
    attributes or the object's colour; owner (H, W), one more than the object's number, 0 on ground.
    """
    height, width = which.shape
    cells = columns - 1
    first_object = 2 * cells * (len(ground) // columns - 1)
    for row in range(height):
        y0 = (row - lens[3]) / lens[1]
        for column in range(width):
            number = which[row, column]
            if number < 0:
                depth_m[row, column] = np.inf
                continue
            depth_m[row, column] = _F(1) / inverse[row, column]
            x0 = (column - lens[2]) / lens[0]
            x = axes[0, 0] * x0 + axes[0, 1] * y0 + axes[0, 2]
            y = axes[1, 0] * x0 + axes[1, 1] * y0 + axes[1, 2]
            z = axes[2, 0] * x0 + axes[2, 1] * y0 + axes[2, 2]
            on_ground = number < first_object
            if on_ground:
                cell = number >> 1
                a = cell // cells * columns + cell % cells
                b = a + columns + (number & 1)
                c = a + 1 if number & 1 else b + 1
                ax, ay, az = ground[a, 0], ground[a, 1], ground[a, 2]
                bx, by, bz = ground[b, 0], ground[b, 1], ground[b, 2]
                cx, cy, cz = ground[c, 0], ground[c, 1], ground[c, 2]
            else:
                number -= first_object
                a = np.int64(triangles[number, 0])
                b, c = np.int64(triangles[number, 1]), np.int64(triangles[number, 2])
                ax, ay, az = points[a, 0], points[a, 1], points[a, 2]
                bx, by, bz = points[b, 0], points[b, 1], points[b, 2]
                cx, cy, cz = points[c, 0], points[c, 1], points[c, 2]
            # Shares of the corners at the point that the ray meets.
            px, py, pz = ax - eye[0], ay - eye[1], az - eye[2]
            qx, qy, qz = bx - eye[0], by - eye[1], bz - eye[2]
            rx, ry, rz = cx - eye[0], cy - eye[1], cz - eye[2]
            one = x * (qy * rz - qz * ry) + y * (qz * rx - qx * rz) + z * (qx * ry - qy * rx)
            two = x * (ry * pz - rz * py) + y * (rz * px - rx * pz) + z * (rx * py - ry * px)
            three = x * (py * qz - pz * qy) + y * (pz * qx - px * qz) + z * (px * qy - py * qx)
            facing = one + two + three  # positive where the triangle is seen from behind
            u, v, w = _F(one / facing), _F(two / facing), _F(three / facing)
            if on_ground:
                for k in range(3):
                    normals[row, column, k] = (
                        u * ground_normals[a, k]
                        + v * ground_normals[b, k]
                        + w * ground_normals[c, k]
                    )
                    base[row, column, k] = (
                        u * attributes[a, k] + v * attributes[b, k] + w * attributes[c, k]
                    )
                continue
            nx = u * point_normals[a, 0] + v * point_normals[b, 0] + w * point_normals[c, 0]
            ny = u * point_normals[a, 1] + v * point_normals[b, 1] + w * point_normals[c, 1]
            nz = u * point_normals[a, 2] + v * point_normals[b, 2] + w * point_normals[c, 2]
            # Thin sheets and inner sides are seen from behind: turn their normals to the camera.
            turn = _F(-1) if facing > 0 and nx * x + ny * y + nz * z > 0 else _F(1)
            normals[row, column, 0] = turn * nx
            normals[row, column, 1] = turn * ny
            normals[row, column, 2] = turn * nz
            for k in range(3):
                base[row, column, k] = u * colours[a, k] + v * colours[b, k] + w * colours[c, k]
            owner[row, column] = owners[number] + 1


@compiled()
def _clear_of_facets(
    depth: Any, x0: Any, y0: Any, nx: Any, ny: Any, nz: Any, eye: Any, axes: Any
) -> Any:
    """A pixel's point, clear of the surface's facets (coarser far away) that would shade it."""
    lift = 0.004 + 0.004 * min(float(depth), 20.0)
    x = eye[0] + depth * (axes[0, 0] * x0 + axes[0, 1] * y0 + axes[0, 2]) + lift * nx
    y = eye[1] + depth * (axes[1, 0] * x0 + axes[1, 1] * y0 + axes[1, 2]) + lift * ny
    z = eye[2] + depth * (axes[2, 0] * x0 + axes[2, 1] * y0 + axes[2, 2]) + lift * nz
    return x, y, z


@compiled()
def _cell(u: Any, v: Any, place: Any) -> Any:
    """Column and row of a sun map, perhaps beyond it."""
    return (
        int(np.floor((u - place[0]) * place[2] + 0.5)),
        int(np.floor((v - place[1]) * place[2] + 0.5)),
    )


@compiled(
    f"void({_PLANE}, {_VECTORS}, float64[::1], float64[:, ::1], float64[::1], float32[::1], "
    "float32[::1], float32[::1], int64, float32, boolean[:, :, ::1])"
)
def sun_blocks(
    depth_m: Any,
    normals: Any,
    eye: Any,
    axes: Any,
    lens: Any,
    slope: Any,
    near_place: Any,
    far_place: Any,
    side: Any,
    farthest_m: Any,
    blocks: Any,
) -> None:
    """Which blocks of the two sun maps `light` will look at; its arguments.

    side: cells of a map.  Written: blocks (2, B, B), of the near and the far map.
    """
    height, width = depth_m.shape
    count = blocks.shape[1]
    blocks[:] = False
    for row in range(0, height, 2):
        y0 = (row - lens[3]) / lens[1]
        for column in range(0, width, 2):
            depth = np.float64(depth_m[row, column])
            x0 = (column - lens[2]) / lens[0]
            if not depth * np.sqrt(1 + x0 * x0 + y0 * y0) < farthest_m:
                continue
            nx = np.float64(normals[row, column, 0])
            ny = np.float64(normals[row, column, 1])
            nz = np.float64(normals[row, column, 2])
            x, y, z = _clear_of_facets(depth, x0, y0, nx, ny, nz, eye, axes)
            u, v = x - z * slope[0], y - z * slope[1]
            at_u, at_v = _cell(u, v, near_place)
            number = 0
            if not (0 <= at_u < side and 0 <= at_v < side):
                at_u, at_v = _cell(u, v, far_place)
                number = 1
            if 0 <= at_u < side and 0 <= at_v < side:
                blocks[number, at_v * count // side, at_u * count // side] = True


@compiled(
    f"void({_PLANE}, {_VECTORS}, {_PLANE}, float64[::1], float64[:, ::1], float64[::1], "
    f"float32[::1], {_PLANE}, float32[::1], {_PLANE}, float32[::1], float32, float32[:, ::1], "
    f"float64, {_PLANE}, {_PLANE})"
)
def light(
    depth_m: Any,
    normals: Any,
    inverse: Any,
    eye: Any,
    axes: Any,
    lens: Any,
    slope: Any,
    near_tops: Any,
    near_place: Any,
    far_tops: Any,
    far_place: Any,
    farthest_m: Any,
    cap: Any,
    reach_m: Any,
    lit: Any,
    free: Any,
) -> None:
    """Sunlight and openness of every second pixel of every second row.

    near_tops, far_tops: (S, S) sun maps; *_place: (3,) their corner (x, y) and cells a metre.
    cap: (C, 3) directions over the upper half; each pixel of a 4 x 4 patch looks along its own.
    reach_m: how far those look.  Written: lit, free (h, w), 0 to 1.
    """
    height, width = depth_m.shape
    rows, columns = lit.shape
    turns = len(cap) // 16
    for i in range(rows):
        row = 2 * i
        y0 = (row - lens[3]) / lens[1]
        for j in range(columns):
            column = 2 * j
            depth = np.float64(depth_m[row, column])
            lit[i, j], free[i, j] = 0, 1
            x0 = (column - lens[2]) / lens[0]
            if not depth * np.sqrt(1 + x0 * x0 + y0 * y0) < farthest_m:
                continue
            nx = np.float64(normals[row, column, 0])
            ny = np.float64(normals[row, column, 1])
            nz = np.float64(normals[row, column, 2])
            x, y, z = _clear_of_facets(depth, x0, y0, nx, ny, nz, eye, axes)
            u, v = x - z * slope[0], y - z * slope[1]
            lit[i, j] = 1
            at_u, at_v = _cell(u, v, near_place)
            side = near_tops.shape[0]
            if 0 <= at_u < side and 0 <= at_v < side:
                if near_tops[at_v, at_u] > z + 0.3 / near_place[2]:
                    lit[i, j] = 0
            else:
                at_u, at_v = _cell(u, v, far_place)
                side = far_tops.shape[0]
                inside = 0 <= at_u < side and 0 <= at_v < side
                if inside and far_tops[at_v, at_u] > z + 0.3 / far_place[2]:
                    lit[i, j] = 0
            # From here on in camera axes: the z-buffer itself says what is near a ray.
            ex, ey, ez = x - eye[0], y - eye[1], z - eye[2]
            sx = axes[0, 0] * ex + axes[1, 0] * ey + axes[2, 0] * ez
            sy = axes[0, 1] * ex + axes[1, 1] * ey + axes[2, 1] * ez
            sz = axes[0, 2] * ex + axes[1, 2] * ey + axes[2, 2] * ez
            pattern = (i & 3) * 4 + (j & 3)
            open_ways = turns
            for turn in range(turns):
                way = pattern * turns + turn
                wx, wy, wz = cap[way, 0] + 0.9 * nx, cap[way, 1] + 0.9 * ny, cap[way, 2] + 0.9 * nz
                tx = (axes[0, 0] * wx + axes[1, 0] * wy + axes[2, 0] * wz) * reach_m
                ty = (axes[0, 1] * wx + axes[1, 1] * wy + axes[2, 1] * wz) * reach_m
                tz = (axes[0, 2] * wx + axes[1, 2] * wy + axes[2, 2] * wz) * reach_m
                for step in _STEPS:
                    qx, qy, qz = sx + step * tx, sy + step * ty, sz + step * tz
                    if qz < 0.05:
                        break
                    column_q = int(qx / qz * lens[0] + lens[2] + 0.5)
                    row_q = int(qy / qz * lens[1] + lens[3] + 0.5)
                    if column_q < 0 or row_q < 0 or column_q >= width or row_q >= height:
                        break
                    # How far in front of the ray's point the picture's surface lies there.
                    ahead = qz - depth_m[row_q, column_q]
                    if 0.006 + 0.004 * qz < ahead < 0.5:
                        open_ways -= 1
                        break
            free[i, j] = open_ways / turns
