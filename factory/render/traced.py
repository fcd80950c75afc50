"""What tracing every n-th pixel found, spread over the pixels in between, in compiled loops.

Importing this module loads numba.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from ..compiled import compiled
from .cloud.joints import READ, Doubles, Floats

_ZERO = np.float32(0)


@compiled()
def _weigh(
    vertical: np.floating[Any],
    part: Floats,
    across: int,
    limit: np.float32,
    here: Floats,
    there: Floats,
    kept: npt.NDArray[np.bool_],
    found: Floats,
    lit: Doubles,
    dark: Doubles,
    total: Doubles,
) -> None:
    """Add one of the four traced neighbours of each pixel of a row, in a loop without branches."""
    for column in range(len(here)):
        step = abs(there[column] - here[column])
        most = limit * min(there[column], here[column])
        horizontal = part[column] if across else 1 - part[column]
        # Never nothing: a pixel of an edge may have one neighbour alone.
        weight = np.float32(vertical * horizontal + 1e-6) * (1 - step / most)
        weight = weight if kept[column] & (step < most) else 0.0
        bright = weight if found[column] > 0 else 0.0
        lit[column] += bright
        dark[column] += weight - bright
        total[column] += bright * found[column]


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
    lit, dark, total = np.empty(width), np.empty(width), np.empty(width)
    there, found = np.empty(width, np.float32), np.empty(width, np.float32)
    kept = np.empty(width, np.bool_)
    # Of each column: the traced one on its left, and how far it is from there in `stride`.
    left, part = np.empty(width, np.int64), np.empty(width, np.float32)
    for column in range(width):
        left[column] = (column - first) // stride
        part[column] = np.float32((column - first - left[column] * stride) / stride)
    for row in range(height):
        above = (row - first) // stride
        v = np.float32((row - first - above * stride) / stride)
        light, shown = radiance[row], made[row]
        lit[:] = dark[:] = total[:] = 0.0
        for down in range(2):
            i = min(max(above + down, 0), h - 1)
            vertical = v if down else 1 - v
            depths, knowns, shares = depth_m[first + i * stride], known[i], ratio[i]
            for across in range(2):
                for column in range(width):
                    j = min(max(left[column] + across, 0), w - 1)
                    there[column] = depths[first + j * stride]
                    kept[column] = knowns[j]
                    found[column] = shares[j]
                _weigh(
                    vertical,
                    part,
                    across,
                    limit,
                    depth_m[row],
                    there,
                    kept,
                    found,
                    lit,
                    dark,
                    total,
                )
        for column in range(width):
            value = light[column] * (total[column] / lit[column])
            value = light[column] if lit[column] + dark[column] == 0 else value
            shown[column] = value if (light[column] > 0) & (lit[column] >= dark[column]) else _ZERO
    return made
