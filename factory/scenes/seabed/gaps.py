"""Where a depth map from photographs has no depth: far water, depth edges, and patches."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from simnfnd.factory.scenes.seabed.fields import Floats, tiles

MOST_LOST = 0.42  # share of the pixels


def measured(
    rng: np.random.Generator, depth_m: Floats, range_m: Floats, clear_m: float
) -> npt.NDArray[np.bool_]:
    """(H, W) bool: pixels that keep their depth.

    depth_m, range_m: (H, W), inf where there is only water.  clear_m: how far the water lets
    matching work; the border is ragged.  At least 8 to 38 % are lost, small shares more often.
    """
    from simnfnd.factory.scenes.seabed.loops.picture_loops import window

    height, width = depth_m.shape
    scale = width / 968
    shift = rng.uniform(0, 1000, 2)
    where = np.float32(shift[0]), np.float32(shift[1]), np.float32(1 / scale), np.float32(1000)
    texture = tiles().texture
    broad, grain = (window(texture, channel, *where, height, width) for channel in (0, 1))
    seen = range_m < clear_m * (1 + 0.06 * broad + 0.03 * grain)
    keep = seen & ~_edges(depth_m, grain + broad, scale)
    lost_target = 0.08 + 0.3 * rng.random() ** 2
    missing = lost_target - float(1 - keep.mean())
    if missing > 0:
        # Matching fails first far away, then near the picture's border; a few blobs are anywhere.
        x = np.abs(np.arange(width, dtype=np.float32) / width * 2 - 1)
        y = np.abs(np.arange(height, dtype=np.float32) / height * 2 - 1)
        border = np.square(np.square(np.square(np.maximum(x[None], y[:, None]))))
        doubt = np.float32(0.3) * broad + np.float32(0.1) * grain + np.float32(0.9) * border
        doubt += np.float32(2.4) * np.minimum(range_m / np.float32(clear_m), np.float32(1))
        # The least sure pixels go; they are counted, so that the share is met exactly.
        among = doubt[keep]
        count = min(round(missing * keep.size), len(among))
        if count:
            keep &= doubt < np.partition(among, len(among) - count)[len(among) - count]
    return np.asarray(keep, np.bool_)


def _edges(depth_m: Floats, noise: Floats, scale: float) -> npt.NDArray[np.bool_]:
    """Cracks along depth edges, on the far side, of a width that varies."""
    from simnfnd.factory.scenes.seabed.loops.picture_loops import least_around

    finite = np.where(np.isfinite(depth_m), depth_m, np.float32(1e4))
    size = max(round(9 * scale), 3) | 1
    nearest, close = np.empty_like(finite), np.empty_like(finite)
    least_around(finite, _ellipse(size), nearest)
    least_around(finite, _ellipse(max(size // 3, 3) | 1), close)
    wide = (finite > nearest * np.float32(1.12)) & (noise > 0.6)
    narrow = (finite > close * np.float32(1.12)) & (noise > -0.7)
    return np.asarray(wide | narrow)


@functools.cache
def _ellipse(size: int) -> npt.NDArray[np.int64]:
    """(size, 2) rows of a round stencil: distance from its middle and half width."""
    rows = np.arange(size) - size // 2
    half = np.rint(np.sqrt((size // 2) ** 2 - rows**2)).astype(np.int64)
    return np.stack([rows, half], axis=-1)
