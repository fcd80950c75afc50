"""Compiled loops over pictures: lens, sensor, and the pattern of what has no depth.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled
from ..fields import STEPS
from .texture_loops import byte

_F = np.float32
_ZERO, _ONE = _F(0), _F(1)
_STEP = _F(1 / STEPS)
_TILE, _NOISE = "Array(int32, 2, 'C', readonly=True)", "Array(float32, 3, 'C', readonly=True)"
_PLANE, _VECTORS = "float32[:, ::1]", "float32[:, :, ::1]"


@compiled()
def _along(texture: Any, at: Any, part: Any, values: Any) -> None:
    lefts, rights, first, second = at[0], at[1], values[0], values[1]
    for column in range(len(part)):
        here = texture[np.uint32(lefts[column])]
        beside = texture[np.uint32(rights[column])]
        a, b = byte(here, 0), byte(beside, 0)
        first[column] = a + part[column] * (b - a)
        a, b = byte(here, 1), byte(beside, 1)
        second[column] = a + part[column] * (b - a)


@compiled()
def _down(upper: Any, lower: Any, down: Any, values: Any) -> None:
    for column in range(len(values)):
        values[column] = (upper[column] + down * (lower[column] - upper[column])) * _STEP


@compiled(f"void({_TILE}, float32, float32, float32, float32, {_PLANE}, {_PLANE})")
def window(texture: Any, x0: Any, y0: Any, step: Any, period: Any, broad: Any, grain: Any) -> None:
    """The texture's first two channels (H, W) on an even grid of places from (x0, y0) on."""
    height, width = broad.shape
    side = texture.shape[0]
    last, scale = side - 1, _F(side) / period
    at, part = np.empty((2, width), np.int32), np.empty(width, np.float32)
    for column in range(width):
        x = (x0 + _F(column) * step) * scale
        left = int(np.floor(x))
        part[column] = x - _F(left)
        at[0, column], at[1, column] = left & last, (left + 1) & last
    lines = np.empty((2, 2, width), np.float32)  # two rows of the texture, two channels
    held = np.full(2, -1, np.int64)
    for row in range(height):
        y = (y0 + _F(row) * step) * scale
        top = int(np.floor(y))
        down = y - _F(top)
        for way in range(2):
            line = (top + way) & last
            if held[line & 1] != line:
                held[line & 1] = line
                _along(texture[line], at, part, lines[line & 1])
        upper, lower = lines[top & 1], lines[(top + 1) & 1]
        _down(upper[0], lower[0], down, broad[row])
        _down(upper[1], lower[1], down, grain[row])


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


@compiled()
def _exposed(seen: Any, grain: Any, gain: Any, level: Any) -> None:
    for at in range(len(level)):
        value = seen[at] * gain
        light = value if value > _ZERO else _ZERO
        value += np.sqrt(light * _F(2.2e-4) + _F(4e-6)) * grain[at]
        over = value - _F(0.75)
        value /= _ONE + (over if over > _ZERO else _ZERO)  # highlights roll off
        value *= _F(4095)
        value = value if value > _ZERO else _ZERO
        level[at] = np.int32(value if value < _F(4095) else _F(4095))


@compiled(
    f"void({_VECTORS}, float32, {_NOISE}, int64, int64, Array(uint8, 1, 'C', readonly=True), "
    "uint8[:, :, ::1])"
)
def expose(
    seen: Any, gain: Any, noise: Any, down: Any, right: Any, gamma: Any, picture: Any
) -> None:
    """Exposure, the sensor's noise (a tile shifted by `down`, `right`) and gamma, to uint8.

    Rows are flat and arithmetic stands apart from the look-up, so that it does several values at a
    time.
    """
    height, width = seen.shape[:2]
    side = noise.shape[0]
    grain, level = np.empty(3 * width, np.float32), np.empty(3 * width, np.int32)
    for row in range(height):
        tile = noise[(row - down) & (side - 1)].ravel()
        filled, at = 0, -right & (side - 1)
        while filled < width:
            count = min(side - at, width - filled)
            grain[3 * filled : 3 * (filled + count)] = tile[3 * at : 3 * (at + count)]
            filled, at = filled + count, 0
        _exposed(seen[row].ravel(), grain, gain, level)
        out = picture[row].ravel()
        for k in range(3 * width):
            out[k] = gamma[np.uint64(level[k])]


@compiled()
def _least_of_two(first: Any, second: Any, least: Any) -> None:
    for column in range(len(least)):
        least[column] = first[column] if first[column] < second[column] else second[column]


@compiled()
def _lower(least: Any, line: Any) -> None:
    for column in range(len(least)):
        least[column] = line[column] if line[column] < least[column] else least[column]


@compiled(f"void({_PLANE}, int64[:, ::1], {_PLANE})")
def least_around(depth_m: Any, reach: Any, least: Any) -> None:
    """The least value around every pixel, over rows of a stencil: (dy, half width) each.

    Windows of twice the width are the lesser of two, so a wide one takes few steps; each is found
    once for all rows of the stencil that are as wide.
    """
    height, width = depth_m.shape
    widest = 0
    for k in range(len(reach)):
        widest = max(widest, reach[k, 1])
    padded = np.full(width + 2 * widest, np.inf, np.float32)
    ways = np.empty((2, width + 2 * widest), np.float32)
    line = np.empty(width, np.float32)
    least[:] = np.inf
    for at in range(height):
        padded[widest : widest + width] = depth_m[at]
        for half in range(widest + 1):
            wanted = False
            for k in range(len(reach)):
                wanted |= reach[k, 1] == half
            if not wanted:
                continue
            size, span = 2 * half + 1, 1
            now = padded[widest - half : widest + half + width]
            turn = 0
            while 2 * span <= size:
                after = ways[turn, : len(now) - span]
                _least_of_two(now[: len(after)], now[span:], after)
                now, turn, span = after, 1 - turn, 2 * span
            _least_of_two(now[:width], now[size - span : size - span + width], line)
            for k in range(len(reach)):
                row = at - reach[k, 0]
                if reach[k, 1] == half and 0 <= row < height:
                    _lower(least[row], line)


@compiled()
def _doubt(
    depth_m: Any,
    range_m: Any,
    broad: Any,
    grain: Any,
    nearest_m: Any,
    close_m: Any,
    clear_m: Any,
    across: Any,
    y: Any,
    keep: Any,
    doubt: Any,
) -> int:
    kept = 0
    for column in range(len(keep)):
        noise = grain[column] + broad[column]
        seen = range_m[column] < clear_m * (
            _ONE + _F(0.06) * broad[column] + _F(0.03) * grain[column]
        )
        here_m = depth_m[column]
        wide = (here_m > nearest_m[column] * _F(1.12)) & (noise > _F(0.6))
        narrow = (here_m > close_m[column] * _F(1.12)) & (noise > _F(-0.7))
        good = seen & ~(wide | narrow)
        keep[column] = good
        kept += 1 if good else 0
        border = max(across[column], y)
        border *= border
        border *= border
        border *= border
        value = _F(0.3) * broad[column] + _F(0.1) * grain[column] + _F(0.9) * border
        doubt[column] = value + _F(2.4) * min(range_m[column] / clear_m, _ONE)
    return kept


@compiled()
def _ordered(word: Any) -> Any:
    """The bits of a float32 as a number whose order is that of the floats."""
    return np.int64(np.uint32(~word) if word >> 31 else np.uint32(word | np.uint32(0x80000000)))


@compiled(
    f"int64({_PLANE}, {_PLANE}, {_PLANE}, {_PLANE}, {_PLANE}, {_PLANE}, float32, "
    f"boolean[:, ::1], {_PLANE})"
)
def doubts(
    depth_m: Any,
    range_m: Any,
    broad: Any,
    grain: Any,
    nearest_m: Any,
    close_m: Any,
    clear_m: Any,
    keep: Any,
    doubt: Any,
) -> int:
    """How unsure the depth of each pixel is (H, W), and which are near and off edges; how many.

    nearest_m, close_m: least depth around each pixel, far about and near.  See `gaps.measured`.
    """
    height, width = depth_m.shape
    across = np.empty(width, np.float32)
    for column in range(width):
        across[column] = abs(_F(column) / _F(width) * _F(2) - _ONE)
    kept = 0
    for row in range(height):
        y = abs(_F(row) / _F(height) * _F(2) - _ONE)
        kept += _doubt(
            depth_m[row], range_m[row], broad[row], grain[row], nearest_m[row], close_m[row],
            clear_m, across, y, keep[row], doubt[row],
        )  # fmt: skip
    return kept


@compiled(f"float32({_PLANE}, boolean[:, ::1], int64)")
def ranked(values: Any, among: Any, rank: Any) -> Any:
    """The value that `rank` of the chosen ones are less than or equal to; no NaN."""
    high, low = np.zeros(1 << 16, np.int64), np.zeros(1 << 16, np.int64)
    words, chosen = values.reshape(-1).view(np.uint32), among.reshape(-1)
    for k in range(len(words)):
        if chosen[k]:
            high[_ordered(words[k]) >> 16] += 1
    before, top = 0, 0
    while before + high[top] <= rank:
        before += high[top]
        top += 1
    for k in range(len(words)):
        if chosen[k]:
            word = _ordered(words[k])
            if word >> 16 == top:
                low[word & 0xFFFF] += 1
    bottom = 0
    while before + low[bottom] <= rank:
        before += low[bottom]
        bottom += 1
    word = np.uint32(top << 16 | bottom)
    word = word & np.uint32(0x7FFFFFFF) if word >> 31 else ~word
    return np.uint32(word).view(np.float32)
