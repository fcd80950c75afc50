"""Where a depth map from photographs has no depth: far water, depth edges, and patches."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .fields import TILE, Floats, tiles

MOST_LOST = 0.42  # share of the pixels

# Stereo matching reaches no further, however clear the water.
_FURTHEST_M = 20.0


def measured(
    rng: np.random.Generator, depth_m: Floats, range_m: Floats, clear_m: float
) -> npt.NDArray[np.bool_]:
    """(H, W) bool: pixels that keep their depth, decided for every second one.

    depth_m, range_m: (H, W), inf where there is only water.  clear_m: how far the water lets
    matching work; the border is ragged.  About 8 to 38 % are lost, small shares more often.
    """
    from .kernels import STEPS

    scale = depth_m.shape[1] / 968
    near_m, range_m = np.minimum(depth_m[::2, ::2], np.float32(1e4)), range_m[::2, ::2]
    rows, columns = (
        (rng.integers(TILE) + np.arange(size) / scale).astype(np.int64) % (TILE // 2)
        for size in near_m.shape
    )
    words = tiles().texture[rows[:, None], columns]
    step = np.float32(1 / STEPS)
    broad, grain = (words << bits >> 24 for bits in (24, 16))  # its first two channels
    broad, grain = broad * step, grain * step
    # Cracks along depth edges, on the far side, of a width that varies.
    noise = broad + grain
    ragged = np.minimum(np.float32(0.06) * broad + np.float32(0.03) * grain, np.float32(0.2))
    keep = range_m < clear_m * (1 + ragged)
    for reach, level in ((max(round(2 * scale), 1), 0.6), (1, -0.7)):
        behind = near_m > np.float32(1.12) * _least_around(near_m, reach)
        keep &= ~(behind & (noise > np.float32(level)))
    missing = 0.08 + 0.3 * rng.random() ** 2 - float(1 - keep.mean())
    if missing > 0 and keep.any():
        # Matching fails first far away, then near the picture's border; a few blobs are anywhere.
        down, across = (np.linspace(-1, 1, size, dtype=np.float32) ** 8 for size in keep.shape)
        doubt = np.float32(0.3) * broad + np.float32(0.1) * grain
        doubt += np.float32(0.9) * np.maximum(across, down[:, None])
        doubt += np.float32(2.4 / clear_m) * np.minimum(range_m, np.float32(clear_m))
        keep &= doubt <= np.quantile(doubt[keep], 1 - min(missing / keep.mean(), 1))
    whole = keep.repeat(2, axis=0).repeat(2, axis=1)[: depth_m.shape[0], : depth_m.shape[1]]
    return np.asarray(whole & (depth_m < _FURTHEST_M))


def _least_around(values: Floats, reach: int) -> Floats:
    """(H, W) the least of the (2 reach + 1) x (2 reach + 1) values around each."""
    size = 2 * reach + 1
    for axis in (0, 1):
        sides = [(0, 0), (0, 0)]
        sides[axis] = (reach, reach)
        least, span = np.pad(values, sides, constant_values=np.inf), 1
        least = least if axis == 0 else least.T
        while span < size:  # windows of twice the width are the lesser of two
            step = min(span, size - span)
            least, span = np.minimum(least[:-step], least[step:]), span + step
        values = least if axis == 0 else least.T
    return values
