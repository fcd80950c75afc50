"""Compiled loops over the pixels of a depth image: surfaces, normals, light, traced shadows.

Imported where they are used: see `simnfnd.factory.common.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...common.compiled import compiled

_READ = "Array(float32, 2, 'C', readonly=True)"
# With a border of one pixel of nothing all around: depth (H, W); its `joints`; across (W,) and
# down (H,), the directions of columns and rows as depth multiplies them.
_GRID = f"Tuple(({_READ}, uint8[:, ::1], float64[::1], float64[::1]))"
_ROW = "Array(float32, 1, 'C', readonly=True)"
_OUT = "float32[:, ::1]"

# What a pixel is joined to.  RISING is of the pixel on its right and the one below it.
RIGHT = 1
DOWN = 2
FALLING = 4
RISING = 8

# A step between neighbours is large when over this part of the edge ratio.  At the default ratio
# that is 2 % of the depth, more than the steps in which structured-light cameras measure.
_LARGE_STEP = 0.2
# A large step belongs to a slope when at most this many times the step before or after it.  The
# limb of a sphere, the steepest smooth outline there is, ends in steps of 1 : 2.4.
_SLOPE_CHANGE = np.float32(3)
_ZERO = np.float32(0)
_LEAST_M2 = np.float32(1e-12)


@compiled()
def _depth_at(depth_m: Any, row: Any, column: Any) -> Any:
    """Depth of a pixel; 0 beyond the border."""
    if row < 0 or column < 0 or row >= depth_m.shape[0] or column >= depth_m.shape[1]:
        return _ZERO
    return depth_m[row, column]


@compiled()
def _joined(depth_m: Any, at: Any, step_to: Any, limit: Any, small: Any) -> Any:
    """Whether a pixel and its neighbour show one surface; see `joints`.

    at: row and column of the pixel.  step_to: rows and columns from it to the neighbour.
    limit, small: parts of the nearer depth from which a step is an edge, up to which it is small.
    """
    row, column = at
    down, across = step_to
    first = depth_m[row, column]
    second = depth_m[row + down, column + across]
    step = abs(second - first)
    nearer = min(first, second)
    if not step < limit * nearer:
        return False
    if step <= small * nearer:
        return True
    rise = _ZERO
    beyond = _depth_at(depth_m, row - down, column - across)
    if beyond > 0:
        rise = first - beyond if second > first else beyond - first
    beyond = _depth_at(depth_m, row + 2 * down, column + 2 * across)
    if beyond > 0:
        rise = max(rise, beyond - second if second > first else second - beyond)
    return step <= _SLOPE_CHANGE * rise


@compiled(f"uint8[:, ::1]({_READ}, float64)")
def joints(depth_m: Any, edge_ratio: Any) -> Any:
    """(H, W) uint8: the sum of RIGHT, DOWN, FALLING, RISING of each pixel of (H, W) depths.

    Two neighbours are one surface when both are measured and differ by less than `edge_ratio` of
    the nearer depth.  Of such steps, a large one (over a fifth of that) must continue the slope on
    one of its sides at least: the ground seen at grazing incidence is a run of large steps and
    stays whole, while a low object's outline, where one step sticks out, is an edge.
    """
    height, width = depth_m.shape
    limit = np.float32(edge_ratio)
    small = np.float32(_LARGE_STEP * edge_ratio)
    bits = np.zeros((height, width), np.uint8)
    for row in range(height):
        for column in range(width):
            pixel_joints = 0
            pixel = (row, column)
            inner = column + 1 < width
            if inner and _joined(depth_m, pixel, (0, 1), limit, small):
                pixel_joints |= RIGHT
            if row + 1 < height:
                if _joined(depth_m, pixel, (1, 0), limit, small):
                    pixel_joints |= DOWN
                if inner and _joined(depth_m, pixel, (1, 1), limit, small):
                    pixel_joints |= FALLING
                if inner and _joined(depth_m, (row, column + 1), (1, -1), limit, small):
                    pixel_joints |= RISING
            bits[row, column] = pixel_joints
    return bits


@compiled()
def _normals(grid: Any, row: Any, out: Any) -> None:
    """Unit normals of a row of pixels, towards the camera.

    Tangents are central differences over the neighbours that are joined to a pixel, one-sided next
    to an edge; the normal is their cross product.  With neighbours along one direction alone, the
    surface faces the camera as nearly as that tangent allows; without any, the normal is 0.

    grid: see `orient`.  row: without the border.
    out: (6, W); the first three get the normals, the others are for intermediate tangents.
    """
    _cross_tangents(grid, row, out)
    _face_camera(grid, row, out)
    _to_unit_length(out)


@compiled()
def _cross_tangents(grid: Any, row: Any, out: Any) -> None:
    """The cross product and the sum of the two tangents of each pixel of a row; see `_normals`."""
    depth_m, joints, across, down = grid
    depth_of_row = depth_m[row + 1]
    depth_above = depth_m[row]
    depth_below = depth_m[row + 2]
    joints_of_row = joints[row + 1]
    joints_above = joints[row]
    down_above = down[row]
    down_of_row = down[row + 1]
    down_below = down[row + 2]
    normal_x = out[0]
    normal_y = out[1]
    normal_z = out[2]
    tangent_x = out[3]
    tangent_y = out[4]
    tangent_z = out[5]
    # Factors of 0 or 1 instead of branches, so that a processor does several columns at a time.
    for column in range(len(normal_x)):
        k = column + 1  # the grid has a border of one pixel
        to_right = np.float32(joints_of_row[k] & 1)
        to_left = np.float32(joints_of_row[k - 1] & 1)
        to_below = np.float32((joints_of_row[k] >> 1) & 1)
        to_above = np.float32((joints_above[k] >> 1) & 1)
        side = across[k]
        depth = depth_of_row[k]
        x = np.float32(side * depth)
        y = np.float32(down_of_row * depth)

        # Tangent along the row.
        right = depth_of_row[k + 1]
        left = depth_of_row[k - 1]
        row_x = (np.float32(across[k + 1] * right) - x) * to_right
        row_x += (x - np.float32(across[k - 1] * left)) * to_left
        row_y = (np.float32(down_of_row * right) - y) * to_right
        row_y += (y - np.float32(down_of_row * left)) * to_left
        row_z = (right - depth) * to_right + (depth - left) * to_left

        # Tangent along the column.
        below = depth_below[k]
        above = depth_above[k]
        column_x = (np.float32(side * below) - x) * to_below
        column_x += (x - np.float32(side * above)) * to_above
        column_y = (np.float32(down_below * below) - y) * to_below
        column_y += (y - np.float32(down_above * above)) * to_above
        column_z = (below - depth) * to_below + (depth - above) * to_above

        normal_x[column] = column_y * row_z - column_z * row_y
        normal_y[column] = column_z * row_x - column_x * row_z
        normal_z[column] = column_x * row_y - column_y * row_x
        tangent_x[column] = row_x + column_x
        tangent_y[column] = row_y + column_y
        tangent_z[column] = row_z + column_z


@compiled()
def _face_camera(grid: Any, row: Any, out: Any) -> None:
    """Fill the normals of pixels with one tangent: the part of the view direction across it."""
    depth_m, _, across, down = grid
    depth_of_row = depth_m[row + 1]
    down_of_row = down[row + 1]
    normal_x = out[0]
    normal_y = out[1]
    normal_z = out[2]
    tangent_x = out[3]
    tangent_y = out[4]
    tangent_z = out[5]
    for column in range(len(normal_x)):
        if not (normal_x[column] == 0 and normal_y[column] == 0 and normal_z[column] == 0):
            continue
        length = np.sqrt(
            tangent_x[column] * tangent_x[column]
            + tangent_y[column] * tangent_y[column]
            + tangent_z[column] * tangent_z[column]
        )
        if length > 0:
            depth = depth_of_row[column + 1]
            x = np.float32(across[column + 1] * depth)
            y = np.float32(down_of_row * depth)
            unit_x = tangent_x[column] / length
            unit_y = tangent_y[column] / length
            unit_z = tangent_z[column] / length
            along = x * unit_x + y * unit_y + depth * unit_z
            normal_x[column] = along * unit_x - x
            normal_y[column] = along * unit_y - y
            normal_z[column] = along * unit_z - depth


@compiled()
def _to_unit_length(out: Any) -> None:
    """Divide the vectors of the first three rows of `out` by their lengths; 0 stays 0."""
    normal_x = out[0]
    normal_y = out[1]
    normal_z = out[2]
    for column in range(len(normal_x)):
        length = np.sqrt(
            normal_x[column] * normal_x[column]
            + normal_y[column] * normal_y[column]
            + normal_z[column] * normal_z[column]
        )
        has_normal = length > 0
        normal_x[column] = normal_x[column] / length if has_normal else _ZERO
        normal_y[column] = normal_y[column] / length if has_normal else _ZERO
        normal_z[column] = normal_z[column] / length if has_normal else _ZERO


@compiled(f"void({_GRID}, int64, float32[:, :, ::1], float32[:, :, ::1])")
def orient(grid: Any, stride: Any, points_m: Any, normals: Any) -> None:
    """Fill points and normals (h, w, 3) of every `stride`-th pixel."""
    depth_m = grid[0]
    across = grid[2]
    down = grid[3]
    normals_of_row = np.empty((6, depth_m.shape[1] - 2), np.float32)
    for i in range(points_m.shape[0]):
        row = i * stride
        _normals(grid, row, normals_of_row)
        for j in range(points_m.shape[1]):
            column = j * stride
            z = depth_m[row + 1, column + 1]
            points_m[i, j, 0] = across[column + 1] * z
            points_m[i, j, 1] = down[row + 1] * z
            points_m[i, j, 2] = z
            for k in range(3):
                normals[i, j, k] = normals_of_row[k, column]


@compiled(f"void({_GRID}, float32[::1], UniTuple({_OUT}, 3))")
def facing(grid: Any, sonar_m: Any, filled: Any) -> None:
    """Fill the cosines of incidence from camera and sonar, and (range to camera / to sonar)^2.

    `simnfnd.factory.simulation.sonar.surface.mount_weight` says what for.  filled: (H, W) each.
    sonar_m: (3,) position in camera axes, metres.
    """
    to_camera, to_sonar, nearer = filled
    height, width = to_camera.shape
    normals_of_row = np.empty((6, width), np.float32)
    for row in range(height):
        _normals(grid, row, normals_of_row)
        for column in range(width):
            z = grid[0][row + 1, column + 1]
            nx = normals_of_row[0, column]
            ny = normals_of_row[1, column]
            nz = normals_of_row[2, column]
            x = np.float32(grid[2][column + 1] * z)
            y = np.float32(grid[3][row + 1] * z)
            camera_m2 = max(x * x + y * y + z * z, _LEAST_M2)
            to_camera[row, column] = -(nx * x + ny * y + nz * z) / np.sqrt(camera_m2)
            tx = sonar_m[0] - x
            ty = sonar_m[1] - y
            tz = sonar_m[2] - z
            sonar_m2 = max(tx * tx + ty * ty + tz * tz, _LEAST_M2)
            to_sonar[row, column] = (nx * tx + ny * ty + nz * tz) / np.sqrt(sonar_m2)
            nearer[row, column] = camera_m2 / sonar_m2


@compiled(f"{_OUT}({_GRID}, boolean[:, ::1], {_READ}, float32[::1])")
def shade(grid: Any, mask: Any, albedo: Any, sonar_m: Any) -> Any:
    """(H, W) float32 radiance of all pixels, 0 off the surface; no shadows.

    Lambert's and the inverse-square law: albedo * max(cos(incidence), 0) / range^2.
    """
    height, width = mask.shape
    radiance = np.empty((height, width), np.float32)
    normals_of_row = np.empty((6, width), np.float32)
    sonar_x = sonar_m[0]
    sonar_y = sonar_m[1]
    sonar_z = sonar_m[2]
    nx = normals_of_row[0]
    ny = normals_of_row[1]
    nz = normals_of_row[2]
    for row in range(height):
        _normals(grid, row, normals_of_row)
        depth_m = grid[0][row + 1]
        across = grid[2]
        drop = grid[3][row + 1]
        shine = radiance[row]
        inside = mask[row]
        strength = albedo[row]
        for column in range(width):
            z = depth_m[column + 1]
            tx = sonar_x - np.float32(across[column + 1] * z)
            ty = sonar_y - np.float32(drop * z)
            tz = sonar_z - z
            square_m2 = tx * tx + ty * ty + tz * tz
            facing_m = nx[column] * tx + ny[column] * ty + nz[column] * tz
            value = strength[column] * facing_m / (square_m2 * np.sqrt(square_m2))
            lit = inside[column] & (facing_m > 0) & (square_m2 > 0)
            shine[column] = value if lit else _ZERO
    return radiance


@compiled(f"{_OUT}({_READ}, {_READ}, boolean[:, ::1], {_READ}, int64, float32)")
def apply_traced(
    radiance: Any, depth_m: Any, known: Any, ratio: Any, stride: Any, limit: Any
) -> Any:
    """(H, W) float32: full-resolution `radiance` times what tracing every n-th pixel found.

    known, ratio: (h, w) traced over closed-form radiance of every n-th pixel.  Of
    the four around a pixel, those count whose depth differs by less than `limit` of the nearer one,
    by bilinear weight and the more the less it differs: where most of the weight is dark, the pixel
    is.  Without any, it keeps its own.
    """
    traced = np.zeros(radiance.shape, np.float32)
    h, w = known.shape
    for row in range(radiance.shape[0]):
        above = row // stride
        v = np.float32((row - above * stride) / stride)
        for column in range(radiance.shape[1]):
            if not radiance[row, column] > 0:
                continue
            left = column // stride
            u = np.float32((column - left * stride) / stride)
            own_depth = depth_m[row, column]
            lit = 0.0
            dark = 0.0
            total = 0.0
            for corner in range(4):
                down = corner >> 1
                across = corner & 1
                i = min(above + down, h - 1)
                j = min(left + across, w - 1)
                traced_depth = depth_m[i * stride, j * stride]
                step = abs(traced_depth - own_depth)
                most = limit * min(traced_depth, own_depth)
                if not (known[i, j] and step < most):
                    continue
                vertical = v if down else 1 - v
                horizontal = u if across else 1 - u
                # Never nothing: a pixel of an edge may have one neighbour alone.
                weight = np.float32(vertical * horizontal + 1e-6) * (1 - step / most)
                if ratio[i, j] > 0:
                    lit += weight
                    total += weight * ratio[i, j]
                else:
                    dark += weight
            if lit + dark == 0:
                traced[row, column] = radiance[row, column]
            elif lit >= dark:
                traced[row, column] = radiance[row, column] * (total / lit)
    return traced


@compiled("float32[:, ::1](float32[:, ::1], int64)")
def box_mean(values: Any, side: Any) -> Any:
    """(H, W) float32: means over `side` x `side` pixels, an odd number, those beyond the border 0.

    Sums run on in double precision, along a row (up to 5 pixels are added anew) and then down the
    columns: as OpenCV's, to the bit.
    """
    height, width = values.shape
    reach = side // 2
    along = np.empty((height, width))
    for row in range(height):
        total = 0.0
        for column in range(min(reach + 1, width)):
            total += float(values[row, column])
        along[row, 0] = total
        for column in range(1, width):
            coming = column + reach
            going = column - reach - 1
            new = float(values[row, coming]) if coming < width else 0.0
            old = float(values[row, going]) if going >= 0 else 0.0
            total += new - old
            if side <= 5:
                total = 0.0
                for near in range(max(column - reach, 0), min(column + reach + 1, width)):
                    total += float(values[row, near])
            along[row, column] = total
    means = np.empty((height, width), np.float32)
    totals = np.zeros(width)
    for row in range(min(reach, height)):
        for column in range(width):
            totals[column] += along[row, column]
    share = 1.0 / (side * side)
    for row in range(height):
        coming = row + reach
        going = row - reach
        for column in range(width):
            sum_here = totals[column] + (along[coming, column] if coming < height else 0.0)
            means[row, column] = np.float32(sum_here * share)
            totals[column] = sum_here - (along[going, column] if going >= 0 else 0.0)
    return means


@compiled(f"{_OUT}(Array(uint8, 3, 'C', readonly=True), float32[:, ::1])")
def weighted(rgb: Any, tables: Any) -> Any:
    """(H, W) float32: the sum over the channels of (H, W, 3) codes of (3, 256) `tables` at them."""
    height, width = rgb.shape[:2]
    total = np.empty((height, width), np.float32)
    for row in range(height):
        for column in range(width):
            red, green, blue = rgb[row, column]
            total[row, column] = tables[0, red] + tables[1, green] + tables[2, blue]
    return total


@compiled(f"{_OUT}({_READ}, {_READ}, {_READ}, boolean[:, ::1], float32, float32)")
def flattened(luminance: Any, total: Any, share: Any, valid: Any, mean: Any, darkest: Any) -> Any:
    """(H, W) float32: luminance over its local mean total / share, times `mean`, in [darkest, 1].

    0 where not `valid`.
    """
    height, width = luminance.shape
    out = np.zeros((height, width), np.float32)
    tiny = np.float32(1e-6)
    for row in range(height):
        for column in range(width):
            local = max(total[row, column] / max(share[row, column], tiny), tiny)
            value = min(max(luminance[row, column] / local * mean, darkest), np.float32(1))
            out[row, column] = value if valid[row, column] else _ZERO
    return out


@compiled(f"void({_READ}, {_OUT}, float32, float32, {_ROW}, uint16[:, ::1], {_OUT})")
def rounded(
    values: Any, levels: Any, first: Any, step: Any, table: Any, codes: Any, looked_up: Any
) -> None:
    """Fill `codes` (H, W), and `looked_up` with `table` at them.

    0 for values that are not above 0, else (level - first) / step.
    """
    least = np.float32(1)
    most = np.float32(65_534)
    for row in range(len(values)):
        for column in range(values.shape[1]):
            level = min(max(np.rint((levels[row, column] - first) / step), least), most)
            # Whole numbers of 32 bits: several at a time.
            code = np.int32(level if values[row, column] > 0 else _ZERO)
            codes[row, column] = np.uint16(code)
        for column in range(values.shape[1]):
            looked_up[row, column] = table[codes[row, column]]


@compiled(f"void(Array(uint8, 2, 'C', readonly=True), {_ROW}, {_OUT})")
def unfold(planes: Any, table: Any, values: Any) -> None:
    """Fill `values` (H, W) with `table` at the codes that `view.fold` wrote, planes (2, H * W)."""
    height, width = values.shape
    above = np.zeros(width, np.uint16)
    for row in range(height):
        down = np.uint16(0)
        for column in range(width):
            at = row * width + column
            folded = np.uint16(planes[0, at] | np.uint16(planes[1, at]) << 8)
            down = np.uint16(down + np.uint16((folded >> 1) ^ np.uint16(-np.int16(folded & 1))))
            above[column] = np.uint16(above[column] + down)
            values[row, column] = table[above[column]]
