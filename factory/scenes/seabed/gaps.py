"""Where a depth map from photographs has no depth: far water, depth edges, and patches."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.factory.scenes.seabed.fields import Floats, lookup, tiles

MOST_LOST = 0.42  # share of the pixels


def measured(
    rng: np.random.Generator, depth_m: Floats, range_m: Floats, clear_m: float
) -> npt.NDArray[np.bool_]:
    """(H, W) bool: pixels that keep their depth.

    depth_m, range_m: (H, W), inf where there is only water.  clear_m: how far the water lets
    matching work; the border is ragged.  At least 8 to 38 % are lost, small shares more often.
    """
    height, width = depth_m.shape
    scale = width / 968
    rows, columns = np.indices(depth_m.shape, dtype=np.float32)
    shift = rng.uniform(0, 1000, 2)
    pattern = lookup(tiles().texture, columns / scale + shift[0], rows / scale + shift[1], 1000.0)
    broad, grain = pattern[..., 0], pattern[..., 1]
    seen = range_m < clear_m * (1 + 0.06 * broad + 0.03 * grain)
    keep = seen & ~_edges(depth_m, grain + broad, scale)
    lost_target = 0.08 + 0.3 * rng.random() ** 2
    missing = lost_target - float(1 - keep.mean())
    if missing > 0:
        # Matching fails first far away, then near the picture's border; a few blobs are anywhere.
        x, y = columns / width * 2 - 1, rows / height * 2 - 1
        doubt = 0.3 * broad + 0.1 * grain + 2.4 * np.minimum(range_m / clear_m, 1)
        doubt += 0.9 * np.maximum(np.abs(x), np.abs(y)) ** 8
        # The least sure pixels go; they are counted, so that the share is met exactly.
        among = np.where(keep, doubt, -np.inf).ravel()
        count = min(round(missing * keep.size), int(keep.sum()))
        limit = np.partition(among, keep.size - count)[keep.size - count] if count else np.inf
        keep &= doubt < limit
    return keep


def _edges(depth_m: Floats, noise: Floats, scale: float) -> npt.NDArray[np.bool_]:
    """Cracks along depth edges, on the far side, of a width that varies."""
    finite = np.where(np.isfinite(depth_m), depth_m, np.float32(1e4))
    size = max(round(9 * scale), 3) | 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    nearest = cv2.erode(finite, kernel)
    small = max(size // 3, 3) | 1
    close = cv2.erode(finite, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (small, small)))
    wide = (finite > nearest * 1.12) & (noise > 0.6)
    narrow = (finite > close * 1.12) & (noise > -0.7)
    return np.asarray(wide | narrow)
