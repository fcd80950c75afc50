"""Which pixels are one surface, in compiled loops.

`cloud.joined` and `surface_mask` are the same in numpy, and what the tests hold these to.
Importing this module loads numba.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ...compiled import compiled
from . import LARGE_STEP, SLOPE_CHANGE

Floats = npt.NDArray[np.float32]
Doubles = npt.NDArray[np.float64]
Bits = npt.NDArray[np.uint8]
READ = "Array(float32, 2, 'C', readonly=True)"

# What a pixel is joined to, as `cloud.joined` says.  RISING is of the pixel on its right
# and the one below it.
RIGHT, DOWN, FALLING, RISING = 1, 2, 4, 8
_ZERO = np.float32(0)
_LARGE, _CHANGE = LARGE_STEP, np.float32(SLOPE_CHANGE)


@compiled()
def _depth_at(depth_m: Floats, row: int, column: int) -> np.float32:
    if row < 0 or column < 0 or row >= depth_m.shape[0] or column >= depth_m.shape[1]:
        return _ZERO
    there: np.float32 = depth_m[row, column]
    return there


@compiled()
def _joined(
    depth_m: Floats,
    row: int,
    column: int,
    down: int,
    across: int,
    limit: np.float32,
    small: np.float32,
) -> bool:
    first, second = depth_m[row, column], depth_m[row + down, column + across]
    step, nearer = abs(second - first), min(first, second)
    if not step < limit * nearer:
        return False
    if step <= small * nearer:
        return True
    rise = _ZERO
    there = _depth_at(depth_m, row - down, column - across)
    if there > 0:
        rise = first - there if second > first else there - first
    there = _depth_at(depth_m, row + 2 * down, column + 2 * across)
    if there > 0:
        rise = max(rise, there - second if second > first else second - there)
    goes_on: bool = step <= _CHANGE * rise
    return goes_on


@compiled(f"uint8[:, ::1]({READ}, float64)")
def joints(depth_m: Floats, edge_ratio: float) -> Bits:
    """(H, W) uint8: the sum of RIGHT, DOWN, FALLING, RISING of each pixel of (H, W) depths."""
    height, width = depth_m.shape
    limit, small = np.float32(edge_ratio), np.float32(_LARGE * edge_ratio)
    bits = np.zeros((height, width), np.uint8)
    for row in range(height):
        for column in range(width):
            found = 0
            inner = column + 1 < width
            if inner and _joined(depth_m, row, column, 0, 1, limit, small):
                found |= RIGHT
            if row + 1 < height:
                if _joined(depth_m, row, column, 1, 0, limit, small):
                    found |= DOWN
                if inner and _joined(depth_m, row, column, 1, 1, limit, small):
                    found |= FALLING
                if inner and _joined(depth_m, row, column + 1, 1, -1, limit, small):
                    found |= RISING
            bits[row, column] = found
    return bits


@compiled("boolean[:, ::1](uint8[:, ::1])")
def surface_mask(bits: Bits) -> npt.NDArray[np.bool_]:
    """(H, W) bool: `cloud.surface_mask` of the depths that gave these joints."""
    height, width = bits.shape
    mask = np.zeros((height, width), np.bool_)
    for row in range(height - 1):
        for column in range(width - 1):
            here = bits[row, column]
            top, left = here & RIGHT != 0, here & DOWN != 0
            bottom, right = bits[row + 1, column] & RIGHT != 0, bits[row, column + 1] & DOWN != 0
            falling, rising = here & FALLING != 0, here & RISING != 0
            acb, dbc = top and left and rising, bottom and right and rising
            adb, dac = top and right and falling, bottom and left and falling
            falls = (adb and dac and not (acb and dbc)) or ((adb or dac) and not (acb or dbc))
            upper, lower = (adb, dac) if falls else (acb, dbc)
            if upper:
                mask[row, column] = mask[row, column + 1] = True
            if lower:
                mask[row + 1, column] = mask[row + 1, column + 1] = True
            if falls and (upper or lower):
                mask[row, column] = mask[row + 1, column + 1] = True
            elif upper or lower:
                mask[row, column + 1] = mask[row + 1, column] = True
    return mask
