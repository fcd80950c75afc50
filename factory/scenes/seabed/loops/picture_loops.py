"""Compiled loops over pictures: lens, sensor, and the pattern of what has no depth.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simnfnd.factory.compiled import compiled
from simnfnd.factory.scenes.seabed.fields import STEPS

_F = np.float32
_ZERO, _ONE = _F(0), _F(1)
_STEP = _F(1 / STEPS)
_TILE, _NOISE = (f"Array({kind}, 3, 'C', readonly=True)" for kind in ("int8", "float32"))
_PLANE, _VECTORS = "float32[:, ::1]", "float32[:, :, ::1]"


@compiled(f"float32[:, ::1]({_TILE}, int64, float32, float32, float32, float32, int64, int64)")
def window(
    tile: Any, channel: Any, x0: Any, y0: Any, step: Any, period: Any, height: Any, width: Any
) -> Any:
    """(H, W) values of a tile's channel on an even grid of places that begins at (x0, y0)."""
    side = tile.shape[0]
    last, scale = side - 1, _F(side) / period
    values = np.empty((height, width), np.float32)
    for row in range(height):
        y = (y0 + _F(row) * step) * scale
        top = int(np.floor(y))
        down = y - _F(top)
        top, below = top & last, (top + 1) & last
        for column in range(width):
            x = (x0 + _F(column) * step) * scale
            left = int(np.floor(x))
            right = x - _F(left)
            left, beside = left & last, (left + 1) & last
            upper = _F(tile[top, left, channel])
            upper += right * (_F(tile[top, beside, channel]) - upper)
            lower = _F(tile[below, left, channel])
            lower += right * (_F(tile[below, beside, channel]) - lower)
            values[row, column] = (upper + down * (lower - upper)) * _STEP
    return values


@compiled(f"void({_VECTORS}, float32[::1], float32[::1], {_VECTORS})")
def through_lens(colour: Any, haze: Any, weights: Any, seen: Any) -> None:
    """Take the haze away, blur a little and darken toward the corners.

    colour: (H, W, 3); its negative parts are lost.  haze: (3,).  weights: (2,) of the blur, for the
    pixel and for each neighbour.  Written: seen (H, W, 3).
    """
    height, width = colour.shape[:2]
    lines = np.empty((3, width * 3), np.float32)
    middle, beside = weights[0], weights[1]
    for row in range(-1, height):
        after = min(row + 1, height - 1)
        line = lines[(row + 1) % 3]
        clean = np.empty((width + 2, 3), np.float32)
        for column in range(width):
            for k in range(3):
                clean[column + 1, k] = max(colour[after, column, k] - haze[k], _ZERO)
        clean[0], clean[width + 1] = clean[2], clean[width - 1]
        flat = clean.ravel()
        for at in range(3 * width):
            line[at] = middle * flat[at + 3] + beside * (flat[at] + flat[at + 6])
        if row < 0:
            lines[2] = line
            continue
        above, here = lines[(row - 1) % 3], lines[row % 3]
        y = _F(2 * row) / _F(height - 1) - _ONE
        out = seen[row].ravel()
        for column in range(width):
            x = _F(2 * column) / _F(width - 1) - _ONE
            shade = _ONE - _F(0.16) * (x * x + y * y)
            for k in range(3):
                at = 3 * column + k
                out[at] = (middle * here[at] + beside * (above[at] + line[at])) * shade


@compiled(
    f"void({_VECTORS}, float32, {_NOISE}, int64, int64, Array(uint8, 1, 'C', readonly=True), "
    "uint8[:, :, ::1])"
)
def expose(
    seen: Any, gain: Any, noise: Any, down: Any, right: Any, gamma: Any, picture: Any
) -> None:
    """Exposure, the sensor's noise (a tile shifted by `down`, `right`) and gamma, to uint8."""
    height, width = seen.shape[:2]
    side = noise.shape[0]
    for row in range(height):
        grain = noise[(row - down) & (side - 1)]
        for column in range(width):
            at = (column - right) & (side - 1)
            for k in range(3):
                value = seen[row, column, k] * gain
                value += np.sqrt(max(value, _ZERO) * _F(2.2e-4) + _F(4e-6)) * grain[at, k]
                value /= _ONE + max(value - _F(0.75), _ZERO)  # highlights roll off
                level = min(max(value * _F(4095), _ZERO), _F(4095))
                picture[row, column, k] = gamma[int(level)]


@compiled(f"void({_PLANE}, int64[:, ::1], {_PLANE})")
def least_around(depth_m: Any, reach: Any, least: Any) -> None:
    """The least value around every pixel, over rows of a stencil: (dy, half width) each."""
    height, width = depth_m.shape
    widest = 0
    for k in range(len(reach)):
        widest = max(widest, reach[k, 1])
    padded = np.full(width + 2 * widest, np.inf, np.float32)
    for row in range(height):
        out = least[row]
        out[:] = np.inf
        for k in range(len(reach)):
            at = row + reach[k, 0]
            if at < 0 or at >= height:
                continue
            padded[widest : widest + width] = depth_m[at]
            for shift in range(widest - reach[k, 1], widest + reach[k, 1] + 1):
                shifted = padded[shift : shift + width]
                for column in range(width):
                    value = shifted[column]
                    out[column] = value if value < out[column] else out[column]
