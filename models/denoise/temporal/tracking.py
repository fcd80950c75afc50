"""Moving targets: what deviates from the scene along a straight path through the window.

A faint target is lost in the noise of one frame, but a window of frames shows it several times
along its path.  The deviations of the frames are summed along candidate velocities (track before
detect; Y. Barniv, IEEE Trans. Aerosp. Electron. Syst. 1985); the velocity with the largest sum
explains a pixel best.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ....factory.common.array_types import Array, Float64s

MAX_OFFSET = 3
"""Frames before and after a frame along which a path is straight: animals turn."""
_VELOCITY_STEP = 0.5
_MAX_VELOCITY = 3.0
"""Reduced pixels per frame: between candidate velocities, and of the fastest one."""
_MAX_DEVIATION = 4.0
"""A single frame counts at most as so many standard deviations, so that a glint is no path."""
_LEVELS_PER_DEVIATION = 8
_INDEX_BITS = 7
"""A 16-bit integer holds a sum of deviations (9 bits) and the index of its velocity."""


@dataclass(frozen=True, eq=False)
class Tracks:
    """The best path through each pixel of a reduced image.

    mean: (h, w) float32, mean deviation along the path, in standard deviations of one frame.
    score: (h, w) float32, the same in standard deviations of such a mean.
    velocity_px: (h, w, 2) float32, right and down, reduced pixels per frame.
    """

    mean: Array
    score: Array
    velocity_px: Array


def find_tracks(deviations: Mapping[int, Array]) -> Tracks:
    """The path through each pixel along which deviations add up to the largest magnitude.

    deviations: frame offset -> (h, w) float32, deviation from the scene in standard deviations of
    the noise.  Offset 0 is the frame itself; offsets beyond `MAX_OFFSET` are left out.
    """
    near = {offset: plane for offset, plane in deviations.items() if abs(offset) <= MAX_OFFSET}
    packed = {offset: _pack(plane) for offset, plane in near.items()}
    own = packed.pop(0)
    largest = np.full(own.shape, np.iinfo(np.int16).min, np.int16)
    smallest = np.full(own.shape, np.iinfo(np.int16).max, np.int16)
    total = np.empty_like(own)
    velocities = candidate_velocities()
    for index, velocity in enumerate(velocities):
        np.add(own, np.int16(index), out=total)
        for offset, plane in packed.items():
            right, down = np.rint(velocity * offset).astype(int)
            inside, shifted = _overlap(own.shape, int(right), int(down))
            np.add(total[inside], plane[shifted], out=total[inside])
        np.maximum(largest, total, out=largest)
        np.minimum(smallest, total, out=smallest)
    is_bright = largest >= -smallest.astype(np.int32)
    best = np.where(is_bright, largest, smallest)
    deviation_sum = (best >> _INDEX_BITS) / np.float32(_LEVELS_PER_DEVIATION)
    best_index = best & ((1 << _INDEX_BITS) - 1)
    return Tracks(
        mean=deviation_sum / np.float32(len(near)),
        score=deviation_sum / np.float32(np.sqrt(len(near))),
        velocity_px=velocities[best_index].astype(np.float32),
    )


def mean_along(planes: Mapping[int, Array], velocity_px: Array) -> Array:
    """Mean of planes along the path through each pixel, (H, W) or (H, W, C) float32.

    planes: frame offset -> (H, W) or (H, W, C).  velocity_px: (H, W, 2), right and down, pixels
    per frame.
    """
    height, width = velocity_px.shape[:2]
    column = np.arange(width, dtype=np.float32)[None, :]
    row = np.arange(height, dtype=np.float32)[:, None]
    total: Array = np.zeros_like(next(iter(planes.values())))
    for offset, plane in planes.items():
        if offset == 0:
            total += plane
            continue
        columns = column + np.float32(offset) * velocity_px[..., 0]
        rows = row + np.float32(offset) * velocity_px[..., 1]
        total += cv2.remap(plane, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return total / np.float32(len(planes))


@cache
def candidate_velocities() -> Float64s:
    """(n, 2) right and down, reduced pixels per frame: a disc of even steps."""
    steps = np.arange(-_MAX_VELOCITY, _MAX_VELOCITY + _VELOCITY_STEP / 2, _VELOCITY_STEP)
    right, down = np.meshgrid(steps, steps)
    inside = np.hypot(right, down) <= _MAX_VELOCITY + 1e-9
    return np.stack([right[inside], down[inside]], axis=-1)


def _pack(deviation: Array) -> npt.NDArray[np.int16]:
    """Deviations as integers that leave the lowest bits to the index of a velocity."""
    clipped = np.clip(deviation, -_MAX_DEVIATION, _MAX_DEVIATION)
    levels = np.rint(clipped * _LEVELS_PER_DEVIATION).astype(np.int16)
    return np.asarray(levels << _INDEX_BITS, np.int16)


def _overlap(shape: tuple[int, ...], right: int, down: int) -> tuple[Any, Any]:
    """Slices of the pixels whose shifted position lies inside too, and of these positions."""
    height, width = shape
    inside = np.s_[
        max(0, -down) : height - max(0, down),
        max(0, -right) : width - max(0, right),
    ]
    shifted = np.s_[
        max(0, down) : height - max(0, -down),
        max(0, right) : width - max(0, -right),
    ]
    return inside, shifted
