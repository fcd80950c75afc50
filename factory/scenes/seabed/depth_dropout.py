"""Where a depth map from photographs has no depth: far water, depth edges, and patches."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from .fields import Floats, tiles

MOST_LOST = 0.42  # share of the pixels


def measured(
    rng: np.random.Generator, depth_m: Floats, range_m: Floats, clear_m: float
) -> npt.NDArray[np.bool_]:
    """(H, W) bool: pixels that keep their depth.

    depth_m, range_m: (H, W), inf where there is only water.  clear_m: how far the water lets
    matching work; the border is ragged.  At least 8 to 38 % are lost, small shares more often.
    """
    from .loops.picture_loops import (
        doubts,
        least_around,
        ranked,
        window,
    )

    scale = depth_m.shape[1] / 968
    shift = rng.uniform(0, 1000, 2)
    where = np.float32(shift[0]), np.float32(shift[1]), np.float32(1 / scale), np.float32(1000)
    broad, grain, nearest_m, close_m, doubt = (np.empty_like(depth_m) for _ in range(5))
    window(tiles().texture, *where, broad, grain)
    # Cracks along depth edges, on the far side, of a width that varies.
    finite_m = np.minimum(depth_m, np.float32(1e4))
    size = max(round(9 * scale), 3) | 1
    least_around(finite_m, _ellipse(size), nearest_m)
    least_around(finite_m, _ellipse(max(size // 3, 3) | 1), close_m)
    keep = np.empty(depth_m.shape, dtype=np.bool_)
    # Matching fails first far away, then near the picture's border; a few blobs are anywhere.
    kept = doubts(
        finite_m, range_m, broad, grain, nearest_m, close_m, np.float32(clear_m), keep, doubt
    )
    missing = 0.08 + 0.3 * rng.random() ** 2 - float(1 - kept / keep.size)
    # The least sure pixels go; they are counted, so that the share is met exactly.
    count = min(round(missing * keep.size), kept) if missing > 0 else 0
    if count:
        keep &= doubt < ranked(doubt, keep, kept - count)
    return keep


@functools.cache
def _ellipse(size: int) -> npt.NDArray[np.int64]:
    """(size, 2) rows of a round stencil: distance from its middle and half width."""
    rows = np.arange(size) - size // 2
    half = np.rint(np.sqrt((size // 2) ** 2 - rows**2)).astype(np.int64)
    return np.stack([rows, half], axis=-1)
