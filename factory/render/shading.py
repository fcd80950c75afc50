"""Normals and light of all pixels, in compiled loops.

`cloud.normals` and `surface.shade` are the same in numpy, and what the tests
hold these to; `facing` is for a sonar beside the camera (`simnfnd.factory.sonar.surface`).
Importing this module loads numba.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from simnfnd.factory.compiled import compiled
from simnfnd.factory.render.cloud.joints import DOWN, READ, RIGHT, Bits, Doubles, Floats

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
    for i in range(points_m.shape[0]):
        row = first + i * stride
        for j in range(points_m.shape[1]):
            column = first + j * stride
            z = depth_m[row, column]
            points_m[i, j, 0] = across[column] * z
            points_m[i, j, 1] = down[row] * z
            points_m[i, j, 2] = z
            x, y, z = _normal(depth_m, bits, row, column, across, down)
            normals[i, j, 0], normals[i, j, 1], normals[i, j, 2] = x, y, z


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
def _row(width: int) -> Floats:
    return np.zeros(width, np.float32)


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


@compiled(f"float32[:, ::1]({READ}, {READ}, boolean[:, ::1], {READ}, int64, int64, float32)")
def apply_traced(
    radiance: Floats,
    depth_m: Floats,
    known: npt.NDArray[np.bool_],
    ratio: Floats,
    first: int,
    stride: int,
    limit: np.float32,
) -> Floats:
    """(H, W) float32: full-resolution `radiance` times what tracing every n-th pixel found.

    known, ratio: (h, w) traced over closed-form radiance of the pixels from (first, first) on.  Of
    the four around a pixel, those count whose depth differs by less than `limit` of the nearer one,
    by bilinear weight and the more the less it differs: where most of the weight is dark, the pixel
    is.  Without any, it keeps its own.
    """
    height, width = depth_m.shape
    h, w = known.shape
    made = np.zeros((height, width), np.float32)
    for row in range(height):
        above = (row - first) // stride
        v = np.float32((row - first - above * stride) / stride)
        for column in range(width):
            if radiance[row, column] <= 0:
                continue
            left = (column - first) // stride
            u = np.float32((column - first - left * stride) / stride)
            here = depth_m[row, column]
            lit = dark = total = _ZERO
            for down in range(2):
                i = min(max(above + down, 0), h - 1)
                for across in range(2):
                    j = min(max(left + across, 0), w - 1)
                    if not known[i, j]:
                        continue
                    there = depth_m[first + i * stride, first + j * stride]
                    if abs(there - here) >= limit * min(there, here):
                        continue
                    # Never nothing: a pixel of an edge may have one neighbour alone.
                    weight = np.float32((v if down else 1 - v) * (u if across else 1 - u) + 1e-6)
                    weight *= 1 - abs(there - here) / (limit * min(there, here))
                    if ratio[i, j] > 0:
                        lit += weight
                        total += weight * ratio[i, j]
                    else:
                        dark += weight
            if lit + dark == 0:
                made[row, column] = radiance[row, column]
            elif lit >= dark:
                made[row, column] = radiance[row, column] * (total / lit)
    return made
