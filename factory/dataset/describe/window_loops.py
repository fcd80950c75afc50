"""The Gaussian window of SSIM as compiled loops: to the bit as OpenCV has it where there is FMA.

Every product is added in one rounding; LLVM does so where there is no such instruction, too, so the
figures are the same on every processor.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import numpy.typing as npt
from numba.extending import intrinsic

from ...compiled import compiled

Values = npt.NDArray[np.float64]


def _product_added(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """The number a * b + c, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.fma(*values)

    number = numba.types.float64
    return number(number, number, number), generate


# Callers leave `typing` out, which numba's types do not know.
_fused: Any = intrinsic(_product_added)


@compiled("int64(int64, int64)")
def _mirrored(index: int, count: int) -> int:
    """Where index lies when 0..count - 1 is mirrored at its ends, the last value twice."""
    while index < 0 or index >= count:
        index = -1 - index if index < 0 else 2 * count - 1 - index
    return index


@compiled("float64[:, ::1](Array(float64, 2, 'C', readonly=True), float64[::1])")
def windowed(values: Values, window: Values) -> Values:
    """(H, W) means of (H, W) values under a symmetric window along columns, then along rows.

    window: (n + 1,) weights from the middle outwards.  Borders are mirrored.
    """
    height, width = values.shape
    reach = len(window) - 1
    along = np.empty((height, width))
    wide = np.empty(width + 2 * reach)
    for row in range(height):
        for column in range(width + 2 * reach):
            wide[column] = values[row, _mirrored(column - reach, width)]
        made = along[row]
        for column in range(width):
            made[column] = window[reach] * wide[column]
        for tap in range(1, 2 * reach + 1):
            weight = window[abs(tap - reach)]
            for column in range(width):
                made[column] = _fused(weight, wide[column + tap], made[column])
    means = np.empty((height, width))
    for row in range(height):
        made = means[row]
        for column in range(width):
            made[column] = window[0] * along[row, column]
        for tap in range(1, reach + 1):
            before, after = along[_mirrored(row - tap, height)], along[_mirrored(row + tap, height)]
            for column in range(width):
                made[column] = _fused(window[tap], before[column] + after[column], made[column])
    return means
