"""Compiled loop that judges views of one place, looked up in pictures of all around it.

Imported where it is used: see `simnfnd.factory.compiled`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ....compiled import compiled

_MATRICES = "float64[:, :, ::1]"


@compiled(
    f"void({_MATRICES}, float64[::1], int64, int64, int64, {_MATRICES}, float64[::1], "
    "float32[:, :, ::1], uint16[:, :, ::1], float64, float64[:, ::1])"
)
def judge(
    candidates: Any,
    lens: Any,
    width: Any,
    height: Any,
    every: Any,
    lookouts: Any,
    lookout_lens: Any,
    inverse: Any,
    numbers: Any,
    clear_m: Any,
    facts: Any,
) -> None:
    """What each candidate camera would see.

    candidates, lookouts: (N, 3, 3), (2, 3, 3) world from camera, of one eye.  lens, lookout_lens:
    (4,) focal lengths and principal point.  every: pixels from one ray to the next.  inverse,
    numbers: (2, h, w) one over the depth in the lookouts, and the object's number, 0 on ground.
    Written: facts (N, 5) share of rays beyond `clear_m`, share nearer than 0.9 m, median depth,
    share on objects within 0.8 `clear_m`, and how many objects those are.
    """
    rows, columns = inverse.shape[1:]
    counted = np.zeros(1 << 16, np.int64)
    depths = np.empty((height // every + 1) * (width // every + 1))
    for number in range(len(candidates)):
        axes = candidates[number]
        rays, lost, near, finite, things, named, kinds = 0, 0, 0, 0, 0, 0, 0
        for row in range(0, height, every):
            y = (row - lens[3]) / lens[1]
            for column in range(0, width, every):
                x = (column - lens[2]) / lens[0]
                rays += 1
                dx = axes[0, 0] * x + axes[0, 1] * y + axes[0, 2]
                dy = axes[1, 0] * x + axes[1, 1] * y + axes[1, 2]
                dz = axes[2, 0] * x + axes[2, 1] * y + axes[2, 2]
                # The lookout on whose side the ray is: the one that looks more its way.
                side, ahead = 0, -1.0
                for k in range(2):
                    along = lookouts[k, 0, 2] * dx + lookouts[k, 1, 2] * dy + lookouts[k, 2, 2] * dz
                    if along > ahead:
                        side, ahead = k, along
                turn = lookouts[side]
                u = (turn[0, 0] * dx + turn[1, 0] * dy + turn[2, 0] * dz) / ahead
                v = (turn[0, 1] * dx + turn[1, 1] * dy + turn[2, 1] * dz) / ahead
                at_u = int(u * lookout_lens[0] + lookout_lens[2] + 0.5)
                at_v = int(v * lookout_lens[1] + lookout_lens[3] + 0.5)
                at_u, at_v = min(max(at_u, 0), columns - 1), min(max(at_v, 0), rows - 1)
                if inverse[side, at_v, at_u] <= 0:
                    lost += 1
                    continue
                # The lookout's depth is along its own axis.
                depth = 1 / (inverse[side, at_v, at_u] * ahead)
                depths[finite] = depth
                finite += 1
                range_m = depth * np.sqrt(1 + x * x + y * y)
                if range_m > clear_m:
                    lost += 1
                if depth < 0.9:
                    near += 1
                thing = numbers[side, at_v, at_u]
                if thing > 0:
                    things += 1
                    if range_m < 0.8 * clear_m:
                        named += 1
                        if counted[thing] != number + 1:
                            counted[thing] = number + 1
                            kinds += 1
        facts[number, 0] = lost / rays
        facts[number, 1] = near / rays
        facts[number, 2] = np.median(depths[:finite]) if finite else 99.0
        facts[number, 3] = named / rays
        facts[number, 4] = kinds
