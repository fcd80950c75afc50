"""How strongly each pixel's surface scatters, taken from its colour.

A camera picture tells where a surface changes (rock, sand, growth), not how well it echoes.  All
kinds therefore only supply a texture between 0 and 1; its mean level is that of `constant`.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from ..compiled import compiled
from .cloud.joints import READ

MEAN_ALBEDO = 0.5

# Nothing measured is perfectly black: radiance 0 is kept for the sonar's shadow.
_DARKEST_RGB = 0.01
_DARKEST_FLATTENED = 0.1

# Linear-light weights of red, green and blue in luminance (ITU-R BT.709, the primaries of sRGB).
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)

# The local mean is taken over a window of this part of the image height: wider than the texture of
# a stone, narrower than the way over which water dims and colours the picture.
_WINDOW = 1 / 8


def albedo(
    rgb: npt.NDArray[np.uint8],
    valid: npt.NDArray[np.bool_],
    kind: Literal["rgb", "flattened", "constant"],
) -> npt.NDArray[np.float32]:
    """(H, W) float32 albedo of a colour image, in (0, 1]; 0 where not `valid`.

    rgb: (H, W, 3) uint8 sRGB.  valid: (H, W) bool, pixels that have a depth.
    kind: rgb is the luminance of the image, in linear light, for it multiplies an echo's energy and
        not its grey value; flattened is that luminance over its local mean, times MEAN_ALBEDO;
        constant is MEAN_ALBEDO.
    """
    if kind == "constant":
        return np.where(valid, np.float32(MEAN_ALBEDO), np.float32(0))
    luminance = linear_luminance(rgb)
    if kind == "rgb":
        return np.where(valid, np.maximum(luminance, np.float32(_DARKEST_RGB)), np.float32(0))
    side = max(3, round(luminance.shape[0] * _WINDOW) | 1)
    weight = valid.astype(np.float32)
    # Two box filters are close to a smooth tent.
    total = _box(_box(luminance * weight, side), side)
    share = _box(_box(weight, side), side)
    return _flatten(
        luminance,
        total,
        share,
        np.ascontiguousarray(valid),
        np.float32(MEAN_ALBEDO),
        np.float32(_DARKEST_FLATTENED),
    )


def linear_luminance(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """(H, W) float32 relative luminance 0..1 of an sRGB image (IEC 61966-2-1 decoding)."""
    code = np.arange(256) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4).astype(
        np.float32
    )
    return _weighted(np.ascontiguousarray(rgb), _LUMINANCE[:, None] * linear)


@compiled("float32[:, ::1](float32[:, ::1], int64)")
def _box(values: npt.NDArray[np.float32], side: int) -> npt.NDArray[np.float32]:
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
            coming, going = column + reach, column - reach - 1
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
        coming, going = row + reach, row - reach
        for column in range(width):
            sum_here = totals[column] + (along[coming, column] if coming < height else 0.0)
            means[row, column] = np.float32(sum_here * share)
            totals[column] = sum_here - (along[going, column] if going >= 0 else 0.0)
    return means


@compiled("float32[:, ::1](Array(uint8, 3, 'C', readonly=True), float32[:, ::1])")
def _weighted(
    rgb: npt.NDArray[np.uint8], tables: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """(H, W) float32: the sum over the channels of (H, W, 3) codes of (3, 256) `tables` at them."""
    height, width = rgb.shape[:2]
    total = np.empty((height, width), np.float32)
    for row in range(height):
        for column in range(width):
            red, green, blue = rgb[row, column]
            total[row, column] = tables[0, red] + tables[1, green] + tables[2, blue]
    return total


@compiled(f"float32[:, ::1]({READ}, {READ}, {READ}, boolean[:, ::1], float32, float32)")
def _flatten(
    luminance: npt.NDArray[np.float32],
    total: npt.NDArray[np.float32],
    share: npt.NDArray[np.float32],
    valid: npt.NDArray[np.bool_],
    mean: np.float32,
    darkest: np.float32,
) -> npt.NDArray[np.float32]:
    """(H, W) float32: luminance over its local mean total / share, times `mean`, in [darkest, 1].

    0 where not `valid`.
    """
    height, width = luminance.shape
    made = np.zeros((height, width), np.float32)
    tiny = np.float32(1e-6)
    for row in range(height):
        for column in range(width):
            local = max(total[row, column] / max(share[row, column], tiny), tiny)
            value = min(max(luminance[row, column] / local * mean, darkest), np.float32(1))
            made[row, column] = value if valid[row, column] else np.float32(0)
    return made
