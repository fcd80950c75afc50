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

import numpy as np
import numpy.typing as npt

from ....factory.common.array_types import Array, Float64s

MAX_OFFSET = 3
"""Frames before and after a frame along which a path is straight: animals turn."""
_VELOCITY_STEP = 0.5
_MAX_VELOCITY = 3.0
"""Reduced pixels per frame: between candidate velocities, and of the fastest one."""
_MAX_DEVIATION = 4.0
"""A single frame counts at most as this many standard deviations, so that a glint is no path."""
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
    from . import kernels  # loads numba

    near = {offset: plane for offset, plane in deviations.items() if abs(offset) <= MAX_OFFSET}
    packed = {offset: _pack(plane) for offset, plane in near.items()}
    own = packed.pop(0)
    velocities = candidate_velocities()
    # Rows and columns from a pixel to where its path is in each plane.
    offsets = np.array([0, *packed])
    steps = np.rint(offsets[None, :, None] * velocities[:, None, ::-1]).astype(np.int64)
    largest, smallest = kernels.best_sums(
        np.stack([own, *packed.values()]), np.ascontiguousarray(steps)
    )
    is_bright = largest >= -smallest.astype(np.int32)
    best = np.where(is_bright, largest, smallest)
    deviation_sum = (best >> _INDEX_BITS) / np.float32(_LEVELS_PER_DEVIATION)
    best_index = best & ((1 << _INDEX_BITS) - 1)
    return Tracks(
        mean=deviation_sum / np.float32(len(near)),
        score=deviation_sum / np.float32(np.sqrt(len(near))),
        velocity_px=np.take(velocities.astype(np.float32), best_index, axis=0),
    )


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
