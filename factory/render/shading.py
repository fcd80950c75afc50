"""Normals and light of all pixels, in compiled loops.

`cloud.normals` and `surface.shade` are the same in numpy, and what the tests
hold these to; `facing` is for a sonar beside the camera (`simnfnd.factory.sonar.surface`).
Importing this module loads numba.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..compiled import compiled
from .cloud.joints import DOWN, READ, RIGHT, Bits, Doubles, Floats

_ZERO = np.float32(0)
_LEAST_M2 = np.float32(1e-12)


@compiled()
def _normal(
    depth_m: Floats, bits: Bits, row: int, column: int, across: Doubles, down: Doubles
) -> tuple[np.float32, np.float32, np.float32]:
    """Unit normal of one pixel, (0, 0, 0) where it has none; see `cloud.normals`."""
    z = depth_m[row, column]
    x, y = np.float32(across[column] * z), np.float32(down[row] * z)
    ax = ay = az = dx = dy = dz = _ZERO
    if bits[row, column] & RIGHT:
        there = depth_m[row, column + 1]
        ax += np.float32(across[column + 1] * there) - x
        ay += np.float32(down[row] * there) - y
        az += there - z
    if column > 0 and bits[row, column - 1] & RIGHT:
        there = depth_m[row, column - 1]
        ax += x - np.float32(across[column - 1] * there)
        ay += y - np.float32(down[row] * there)
        az += z - there
    if bits[row, column] & DOWN:
        there = depth_m[row + 1, column]
        dx += np.float32(across[column] * there) - x
        dy += np.float32(down[row + 1] * there) - y
        dz += there - z
    if row > 0 and bits[row - 1, column] & DOWN:
        there = depth_m[row - 1, column]
        dx += x - np.float32(across[column] * there)
        dy += y - np.float32(down[row - 1] * there)
        dz += z - there
    nx, ny, nz = dy * az - dz * ay, dz * ax - dx * az, dx * ay - dy * ax
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if length == 0:
        lx, ly, lz = ax + dx, ay + dy, az + dz
        along = np.sqrt(lx * lx + ly * ly + lz * lz)
        if along == 0:
            return _ZERO, _ZERO, _ZERO
        lx, ly, lz = lx / along, ly / along, lz / along
        towards = x * lx + y * ly + z * lz
        nx, ny, nz = towards * lx - x, towards * ly - y, towards * lz - z
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length == 0:
            return _ZERO, _ZERO, _ZERO
    return nx / length, ny / length, nz / length


@compiled()
def _row(width: int) -> Floats:
    return np.zeros(width, np.float32)


@compiled(
    f"void({READ}, uint8[:, ::1], float64[::1], float64[::1], int64, int64,"
    "float32[:, :, ::1], float32[:, :, ::1])"
)
def orient(
    depth_m: Floats,
    bits: Bits,
    across: Doubles,
    down: Doubles,
    first: int,
    stride: int,
    points_m: Floats,
    normals: Floats,
) -> None:
    """Fill points and normals (h, w, 3) of every `stride`-th pixel from (first, first) on.

    across, down: (W,) and (H,) direction of each column and row, as depth multiplies it.
    """
    height, width = depth_m.shape
    rows, columns = points_m.shape[:2]
    # Steps to the neighbours on both sides, along the row and down the column, of one row.
    ax, ay, az = _row(columns), _row(columns), _row(columns)
    dx, dy, dz = _row(columns), _row(columns), _row(columns)
    for i in range(rows):
        row = first + i * stride
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        points, made = points_m[i], normals[i]
        for j in range(columns):
            column = first + j * stride
            z, side = depth_m[row, column], across[column]
            x, y = np.float32(side * z), np.float32(down[row] * z)
            points[j, 0], points[j, 1], points[j, 2] = x, y, z
            right, left = min(column + 1, width - 1), max(column - 1, 0)
            to_right = np.float32(bits[row, column] & RIGHT != 0)
            to_left = np.float32((bits[row, left] & RIGHT != 0) & (column > 0))
            there, other = depth_m[row, right], depth_m[row, left]
            step = (np.float32(across[right] * there) - x) * to_right
            ax[j] = step + (x - np.float32(across[left] * other)) * to_left
            step = (np.float32(down[row] * there) - y) * to_right
            ay[j] = step + (y - np.float32(down[row] * other)) * to_left
            az[j] = (there - z) * to_right + (z - other) * to_left
            to_below = np.float32(bits[row, column] & DOWN != 0)
            to_above = np.float32((bits[above, column] & DOWN != 0) & (row > 0))
            there, other = depth_m[below, column], depth_m[above, column]
            step = (np.float32(side * there) - x) * to_below
            dx[j] = step + (x - np.float32(side * other)) * to_above
            step = (np.float32(down[below] * there) - y) * to_below
            dy[j] = step + (y - np.float32(down[above] * other)) * to_above
            dz[j] = (there - z) * to_below + (z - other) * to_above
        for j in range(columns):
            nx, ny = dy[j] * az[j] - dz[j] * ay[j], dz[j] * ax[j] - dx[j] * az[j]
            nz = dx[j] * ay[j] - dy[j] * ax[j]
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if length > 0:
                made[j, 0], made[j, 1], made[j, 2] = nx / length, ny / length, nz / length
            else:
                x, y, z = _normal(depth_m, bits, row, first + j * stride, across, down)
                made[j, 0], made[j, 1], made[j, 2] = x, y, z


@compiled(
    f"void({READ}, uint8[:, ::1], float64[::1], float64[::1], float32[::1],"
    "float32[:, ::1], float32[:, ::1], float32[:, ::1])"
)
def facing(
    depth_m: Floats,
    bits: Bits,
    across: Doubles,
    down: Doubles,
    sonar_m: Floats,
    to_camera: Floats,
    to_sonar: Floats,
    nearer: Floats,
) -> None:
    """Fill the cosines of incidence from camera and sonar, and (range to camera / to sonar)^2.

    `simnfnd.factory.sonar.surface.mount_weight` says what for.

    depth_m, and what is filled: (H, W).  bits: `joints` of the depth.  across, down: direction of
    each column and row, as depth multiplies it.  sonar_m: (3,) position in camera axes, metres.
    """
    height, width = depth_m.shape
    for row in range(height):
        for column in range(width):
            z = depth_m[row, column]
            x, y = np.float32(across[column] * z), np.float32(down[row] * z)
            nx, ny, nz = _normal(depth_m, bits, row, column, across, down)
            camera_m2 = max(x * x + y * y + z * z, _LEAST_M2)
            to_camera[row, column] = -(nx * x + ny * y + nz * z) / np.sqrt(camera_m2)
            tx, ty, tz = sonar_m[0] - x, sonar_m[1] - y, sonar_m[2] - z
            sonar_m2 = max(tx * tx + ty * ty + tz * tz, _LEAST_M2)
            to_sonar[row, column] = (nx * tx + ny * ty + nz * tz) / np.sqrt(sonar_m2)
            nearer[row, column] = camera_m2 / sonar_m2


@compiled()
def _place(z: Floats, across: Doubles, down: float, x: Floats, y: Floats) -> None:
    """Fill x and y of a row of pixels from their depths."""
    for column in range(len(z)):
        x[column] = across[column] * z[column]
        y[column] = down * z[column]


@compiled(
    f"float32[:, ::1]({READ}, uint8[:, ::1], boolean[:, ::1], {READ}, float64[::1],"
    "float64[::1], float32, float32, float32)"
)
def shade(
    depth_m: Floats,
    bits: Bits,
    mask: npt.NDArray[np.bool_],
    albedo: Floats,
    across: Doubles,
    down: Doubles,
    sonar_x_m: np.float32,
    sonar_y_m: np.float32,
    sonar_z_m: np.float32,
) -> Floats:
    """(H, W) float32 radiance of all pixels; see `simnfnd.factory.render.surface.shade`."""
    height, width = depth_m.shape
    radiance = np.empty((height, width), np.float32)
    x, y = np.empty(width, np.float32), np.empty(width, np.float32)
    x_below, y_below = np.empty(width, np.float32), np.empty(width, np.float32)
    # Steps to the right, by the column they end in, and to the rows above and below.
    ax, ay, az = _row(width + 1), _row(width + 1), _row(width + 1)
    ux, uy, uz = _row(width), _row(width), _row(width)
    dx, dy, dz = _row(width), _row(width), _row(width)
    _place(depth_m[0], across, down[0], x, y)
    for row in range(height):
        z, found = depth_m[row], bits[row]
        if row + 1 < height:
            z_below = depth_m[row + 1]
            _place(z_below, across, down[row + 1], x_below, y_below)
            for column in range(width):
                whole = np.float32((found[column] >> 1) & 1)
                dx[column] = (x_below[column] - x[column]) * whole
                dy[column] = (y_below[column] - y[column]) * whole
                dz[column] = (z_below[column] - z[column]) * whole
        else:
            dx[:] = dy[:] = dz[:] = _ZERO
        for column in range(width - 1):
            whole = np.float32(found[column] & 1)
            ax[column + 1] = (x[column + 1] - x[column]) * whole
            ay[column + 1] = (y[column + 1] - y[column]) * whole
            az[column + 1] = (z[column + 1] - z[column]) * whole
        shine, inside, strength = radiance[row], mask[row], albedo[row]
        for column in range(width):
            # No branches: several columns at a time.
            rx, ry = ax[column + 1] + ax[column], ay[column + 1] + ay[column]
            rz = az[column + 1] + az[column]
            vx, vy = dx[column] + ux[column], dy[column] + uy[column]
            vz = dz[column] + uz[column]
            nx, ny, nz = vy * rz - vz * ry, vz * rx - vx * rz, vx * ry - vy * rx
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            tx, ty = sonar_x_m - x[column], sonar_y_m - y[column]
            tz = sonar_z_m - z[column]
            square_m2 = tx * tx + ty * ty + tz * tz
            facing_m = (nx / length) * tx + (ny / length) * ty + (nz / length) * tz
            value = strength[column] * facing_m / (square_m2 * np.sqrt(square_m2))
            lit = inside[column] & (facing_m > 0) & (square_m2 > 0)
            shine[column] = value if lit else _ZERO
        for column in range(width):
            # Neighbours along one direction alone: the surface faces the camera as far as it can.
            if inside[column] and shine[column] == 0:
                nx, ny, nz = _normal(depth_m, bits, row, column, across, down)
                tx, ty = sonar_x_m - x[column], sonar_y_m - y[column]
                tz = sonar_z_m - z[column]
                square_m2 = tx * tx + ty * ty + tz * tz
                facing_m = nx * tx + ny * ty + nz * tz
                if facing_m > 0 and square_m2 > 0:
                    value = strength[column] * facing_m / (square_m2 * np.sqrt(square_m2))
                    shine[column] = value
        x, x_below, y, y_below = x_below, x, y_below, y
        ux, dx, uy, dy, uz, dz = dx, ux, dy, uy, dz, uz
    return radiance
