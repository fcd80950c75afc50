"""Compiled loops of denoising in time; see `simnfnd.factory.common.compiled`.

The steps for which NumPy would go over a frame many times.  All planes are contiguous float32
unless a line says otherwise; reduced planes are (h, w), those of frames (H, W).
"""

from __future__ import annotations

import math

import numpy as np

from ....factory.common.array_types import Array, Float32s, Float64s, Int64s, UInt8s
from ....factory.common.compiled import compiled

_PLANE = "Array(float32, 2, 'C', readonly=True)"
_RESULT = "float32[:, ::1]"
_ZERO = np.float32(0)
_ONE = np.float32(1)


@compiled(f"Tuple(({_RESULT}, {_RESULT}))({_PLANE}, {_PLANE}, {_PLANE}, float32)")
def deviations(
    plane: Float32s, reference: Float32s, sigma: Float32s, most: np.float32
) -> tuple[Float32s, Float32s]:
    """Difference of two planes in standard deviations, and the same clipped at `most`."""
    height, width = plane.shape
    deviation = np.empty((height, width), np.float32)
    clipped = np.empty((height, width), np.float32)
    for row in range(height):
        for column in range(width):
            value = (plane[row, column] - reference[row, column]) / sigma[row, column]
            deviation[row, column] = value
            clipped[row, column] = min(max(value, -most), most)
    return deviation, clipped


@compiled(f"{_RESULT}({_PLANE}, {_PLANE}, {_PLANE}, float32)")
def excess_exponent(
    deviation: Float32s, wide_mean: Array, wide_sigma: Float32s, limit: np.float32
) -> Float32s:
    """Minus the square of what a deviation in either window is above the limit."""
    height, width = deviation.shape
    result = np.empty((height, width), np.float32)
    for row in range(height):
        for column in range(width):
            wide = abs(wide_mean[row, column] / wide_sigma[row, column])
            excess = max(max(abs(deviation[row, column]), wide) - limit, _ZERO)
            result[row, column] = -excess * excess
    return result


@compiled(f"{_RESULT}({_PLANE}, {_PLANE}, {_PLANE})")
def neighbour_weight(with_median: Float32s, with_frame: Float32s, static: Float32s) -> Float32s:
    """How far a neighbour counts, by its agreement; static: agreement of frame and median."""
    height, width = static.shape
    weight = np.empty((height, width), np.float32)
    for row in range(height):
        for column in range(width):
            shows_scene = with_median[row, column]
            of_object = with_frame[row, column] * (_ONE - shows_scene)
            share = static[row, column]
            weight[row, column] = shows_scene * share + of_object * (_ONE - share)
    return weight


@compiled(f"void({_RESULT}, {_RESULT}, {_RESULT}, {_PLANE}, {_PLANE}, {_PLANE})")
def add_weighted(
    total: Array,
    count: Float32s,
    squares: Array,
    levels: Float32s,
    weight: Float32s,
    visible: Float32s,
) -> None:
    """Add a frame to sums of levels, of weights and of their squares."""
    height, width = total.shape
    for row in range(height):
        for column in range(width):
            part = weight[row, column] * visible[row, column]
            total[row, column] += levels[row, column] * part
            count[row, column] += part
            squares[row, column] += part * part


@compiled(f"Tuple(({_RESULT}, {_RESULT}))({_PLANE}, {_PLANE}, {_PLANE})")
def mean_and_count(total: Array, count: Float32s, squares: Array) -> tuple[Float32s, Float32s]:
    """Weighted mean, and the effective number of frames in it, of the sums of `add_weighted`."""
    height, width = total.shape
    mean = np.empty((height, width), np.float32)
    frames = np.empty((height, width), np.float32)
    for row in range(height):
        for column in range(width):
            weights = max(count[row, column], np.float32(1e-3))
            mean[row, column] = total[row, column] / weights
            square = max(squares[row, column], np.float32(1e-6))
            frames[row, column] = weights * weights / square
    return mean, frames


@compiled("Tuple((int16[:, ::1], int16[:, ::1]))(int16[:, :, ::1], int64[:, :, ::1])")
def best_sums(packed: Array, steps: Int64s) -> tuple[Array, Array]:
    """Largest and smallest sum of planes along paths, with the index of the path in its low bits.

    packed: (n, h, w) int16, the frame's own plane first; zeros in the low bits.
    steps: (paths, n, 2) rows and columns from a pixel to where its path is in each plane.
    Planes that a path has left add nothing.  Returns (h, w) twice.
    """
    count, height, width = packed.shape
    largest = np.full((height, width), -32768, np.int16)
    smallest = np.full((height, width), 32767, np.int16)
    total = np.empty(width, np.int16)
    for row in range(height):
        most = largest[row]
        least = smallest[row]
        for path in range(len(steps)):
            index = np.int16(path)
            own = packed[0, row]
            for column in range(width):
                total[column] = own[column] + index
            for plane in range(1, count):
                other_row = row + steps[path, plane, 0]
                if other_row < 0 or other_row >= height:
                    continue
                right = steps[path, plane, 1]
                first = max(0, -right)
                length = width - abs(right)
                if length <= 0:
                    continue
                target = total[first : first + length]
                source = packed[plane, other_row, first + right : first + right + length]
                for column in range(length):
                    target[column] += source[column]
            for column in range(width):
                most[column] = max(most[column], total[column])
                least[column] = min(least[column], total[column])
    return largest, smallest


@compiled(
    f"void({_RESULT}, {_PLANE}, {_PLANE}, {_PLANE}, {_PLANE}, {_PLANE}, "
    "Array(float32, 3, 'C', readonly=True), float32, int64, int64)"
)
def add_along_paths(
    total: Float32s,
    gate: Float32s,
    levels: Float32s,
    scene: Float32s,
    visible: Float32s,
    faint: Float32s,
    velocity_px: Float32s,
    offset: float,
    down: int,
    right: int,
) -> None:
    """Add how a frame deviates from the scene on the path through each pixel, where `gate` > 0.

    offset: number of the frame less that of the denoised one.  faint: (h, w), 1 where the deviation
    counts, else 0.  velocity_px: (h, w, 2) right and down, reduced pixels per frame.
    down, right: pixels of a reduced one, 1 or 2.
    """
    height, width = total.shape
    last_row = np.float32(height - 1)
    last_column = np.float32(width - 1)
    rows, columns = faint.shape
    # Halves by shifts: a division takes longer than all the rest.
    halved_down = down - 1
    halved_right = right - 1
    for row in range(height):
        reduced_row = min(row >> halved_down, rows - 1)
        for column in range(width):
            if gate[row, column] <= 0:
                continue
            reduced_column = min(column >> halved_right, columns - 1)
            x = column + offset * velocity_px[reduced_row, reduced_column, 0] * np.float32(right)
            y = row + offset * velocity_px[reduced_row, reduced_column, 1] * np.float32(down)
            x = min(max(x, _ZERO), last_column)
            y = min(max(y, _ZERO), last_row)
            left = int(x)
            top = int(y)
            across = np.float32(x - left)
            below = np.float32(y - top)
            for lower in range(2):
                row_share = below if lower else _ONE - below
                if row_share == 0:
                    continue
                for further in range(2):
                    share = row_share * (across if further else _ONE - across)
                    if share == 0:
                        continue
                    i = top + lower
                    j = left + further
                    counts = (
                        visible[i, j]
                        * faint[
                            min(i >> halved_down, rows - 1), min(j >> halved_right, columns - 1)
                        ]
                    )
                    total[row, column] += share * counts * (levels[i, j] - scene[i, j])


@compiled(f"{_RESULT}({_PLANE}, float32[::1])")
def by_root_level(grey: Float32s, table: Float32s) -> Float32s:
    """Entry of a table of 256 for each grey value in 0..1, even in its root."""
    height, width = grey.shape
    result = np.empty((height, width), np.float32)
    for row in range(height):
        for column in range(width):
            level = min(max(grey[row, column], _ZERO), _ONE)
            result[row, column] = table[int(np.sqrt(level) * np.float32(255))]
    return result


@compiled(f"Tuple((float64[::1], int64[::1]))({_PLANE}, {_PLANE}, int64, int64, int64)")
def medians_by_level(
    deviation: Float32s, grey: Float32s, levels: int, stride: int, least: int
) -> tuple[Float64s, Int64s]:
    """Median magnitude of deviations in each class of grey value, even in its root.

    Every `stride`-th row and column counts.  Returns (levels,) medians and numbers of pixels; 0 and
    0 where these are fewer than `least`.
    """
    height, width = grey.shape
    counts = np.zeros(levels, np.int64)
    for row in range(0, height, stride):
        for column in range(0, width, stride):
            root = np.sqrt(min(max(grey[row, column], _ZERO), _ONE))
            counts[min(int(root * np.float32(levels)), levels - 1)] += 1
    ends = np.cumsum(counts)
    places = ends - counts
    magnitudes = np.empty(ends[-1], np.float32)
    for row in range(0, height, stride):
        for column in range(0, width, stride):
            root = np.sqrt(min(max(grey[row, column], _ZERO), _ONE))
            level = min(int(root * np.float32(levels)), levels - 1)
            magnitudes[places[level]] = abs(deviation[row, column])
            places[level] += 1
    medians = np.zeros(levels)
    for level in range(levels):
        if counts[level] < least:
            counts[level] = 0
            continue
        medians[level] = np.median(magnitudes[ends[level] - counts[level] : ends[level]])
    return medians, counts


@compiled(
    f"{_RESULT}({_PLANE}, Array(float32, 3, 'C', readonly=True), "
    f"Array(uint8, 2, 'C', readonly=True), {_PLANE}, {_PLANE}, float32[::1])"
)
def weighted_changes(
    grey: Float32s,
    changes: Float32s,
    variation: UInt8s,
    window_share: Float32s,
    tables: Float32s,
    single: Float32s,
) -> Float32s:
    """An image and its changes, each times its coefficient, clipped to 0..1.

    changes: (n, H, W).  variation: level of how much the image varies around a pixel.
    window_share: 0..1, how far a pixel has a whole window.  tables: (n, levels) coefficients in a
    whole window by level.  single: (n,) those of a single frame.
    """
    height, width = grey.shape
    result = np.empty((height, width), np.float32)
    in_window = np.empty(width, np.float32)
    alone = np.empty(width, np.float32)
    for row in range(height):
        in_window[:] = _ZERO
        alone[:] = _ZERO
        for number in range(len(changes)):
            table = tables[number]
            part = single[number]
            for column in range(width):
                change = changes[number, row, column]
                in_window[column] += table[variation[row, column]] * change
                alone[column] += part * change
        for column in range(width):
            share = window_share[row, column]
            change = alone[column] + share * (in_window[column] - alone[column])
            result[row, column] = min(max(grey[row, column] + change, _ZERO), _ONE)
    return result


@compiled(f"uint8[:, ::1]({_PLANE}, {_PLANE}, {_PLANE}, float32, float32)")
def variation_level(
    mean_square: Float32s, mean: Float32s, sigma: Float32s, scale: np.float32, most: np.float32
) -> UInt8s:
    """Level, up to `most`, of how much an image varies around a pixel; `scale` is that of 1 sigma.

    mean_square, mean: of the pixels around.  sigma: standard deviation of the noise.
    """
    height, width = mean.shape
    result = np.empty((height, width), np.uint8)
    for row in range(height):
        for column in range(width):
            middle = mean[row, column]
            spread = max(mean_square[row, column] - middle * middle, _ZERO)
            level = np.sqrt(spread) / max(sigma[row, column], np.float32(1e-4)) * scale
            result[row, column] = np.uint8(min(level, most))
    return result


@compiled(
    "float64[:, :, ::1](Array(float32, 3, 'C', readonly=True), "
    f"Array(uint8, 2, 'C', readonly=True), {_PLANE}, Array(uint8, 2, 'C', readonly=True), "
    "int64[::1], int64)"
)
def normal_equations(
    changes: Float32s,
    variation: UInt8s,
    target: Float32s,
    same: UInt8s,
    class_of: Int64s,
    stride: int,
) -> Float64s:
    """Sums of the products of changes, of the target and of 1 with each other, by class.

    changes: (n, H, W).  target: (H, W).  same: (H, W), not 0 where a pixel counts; of these every
    `stride`-th row and column.  class_of: class of each level of variation.
    Returns (classes, n + 2, n + 2); of changes, then the target, then 1; the lower triangle.
    """
    count, height, width = changes.shape
    classes = class_of[-1] + 1
    sums = np.zeros((classes, count + 2, count + 2))
    values = np.ones(count + 2)
    for row in range(0, height, stride):
        for column in range(0, width, stride):
            if not same[row, column]:
                continue
            for number in range(count):
                values[number] = changes[number, row, column]
            values[count] = target[row, column]
            of_class = sums[class_of[variation[row, column]]]
            for i in range(count + 2):
                for j in range(i + 1):
                    of_class[i, j] += values[i] * values[j]
    return sums


@compiled(f"float64({_PLANE}, {_PLANE})")
def correlation(band: Float32s, other: Float32s) -> float:
    """Correlation where both planes are not 0; -1 where that is less than a quarter of the first.

    Sums are of 64 bits.
    """
    height, width = band.shape
    power = 0.0
    other_power = 0.0
    product = 0.0
    both = 0
    shown = 0
    for row in range(height):
        for column in range(width):
            value = float(band[row, column])
            other_value = float(other[row, column])
            shown += value != 0
            if value != 0 and other_value != 0:
                both += 1
                power += value * value
                other_power += other_value * other_value
                product += value * other_value
    if both < 0.25 * max(shown, 1):
        return -1.0
    return product / max(math.sqrt(power * other_power), 1e-12)


@compiled(f"float64[::1]({_RESULT}, {_PLANE}, {_PLANE}, float32)")
def clip_and_project(
    residual: Array, along: Float32s, down: Float32s, most: np.float32
) -> Float64s:
    """Clip a residual at `most`, in place; (6,) its products with the numbers of a motion.

    along, down: slopes of the image.  The numbers are those of `motion.Motion.affine`.
    """
    height, width = residual.shape
    half = width / 2
    sums = np.zeros(6)
    for row in range(height):
        y = (row - (height - 1) / 2) / half
        right = 0.0
        lower = 0.0
        right_x = 0.0
        lower_x = 0.0
        for column in range(width):
            value = min(max(residual[row, column], -most), most)
            residual[row, column] = value
            x = (column - (width - 1) / 2) / half
            by_right = np.float64(along[row, column]) * value
            by_lower = np.float64(down[row, column]) * value
            right += by_right
            lower += by_lower
            right_x += by_right * x
            lower_x += by_lower * x
        sums[0] += right
        sums[1] += lower
        sums[2] += right_x
        sums[3] += right * y
        sums[4] += lower_x
        sums[5] += lower * y
    return sums


@compiled(f"float64[:, ::1]({_PLANE}, {_PLANE})")
def hessian(along: Float32s, down: Float32s) -> Float64s:
    """(6, 6) products of the changes of an image with the numbers of a motion."""
    height, width = along.shape
    half = width / 2
    # Of the slopes' products: themselves, times x, y, x squared, x y and y squared.
    moments = np.zeros((3, 6))
    for row in range(height):
        y = (row - (height - 1) / 2) / half
        for pair in range(3):
            first = down[row] if pair == 2 else along[row]
            second = along[row] if pair == 0 else down[row]
            power = 0.0
            power_x = 0.0
            power_xx = 0.0
            for column in range(width):
                x = (column - (width - 1) / 2) / half
                product = np.float64(first[column]) * second[column]
                power += product
                power_x += product * x
                power_xx += product * x * x
            moments[pair, 0] += power
            moments[pair, 1] += power_x
            moments[pair, 2] += power * y
            moments[pair, 3] += power_xx
            moments[pair, 4] += power_x * y
            moments[pair, 5] += power * y * y
    # Which slope and which of 1, x, y each number multiplies.
    slopes = (0, 1, 0, 0, 1, 1)
    places = (0, 0, 1, 2, 1, 2)
    result = np.empty((6, 6))
    for i in range(6):
        for j in range(6):
            # 1, x and y have the places 0, 1, 2; their products, those of the moments.
            less = min(places[i], places[j])
            more = max(places[i], places[j])
            moment = more if less == 0 else less + more + 1
            result[i, j] = moments[slopes[i] + slopes[j], moment]
    return result
