"""A frame for tests of what a newcomer sees first."""

from __future__ import annotations

import numpy as np

H, W = 96, 152


def frame() -> tuple[np.ndarray, np.ndarray]:
    """Sloping ground with a few pixels that were not measured."""
    v = np.arange(H)[:, None] / H
    depth_m = np.broadcast_to(1.5 / (0.15 + 0.5 * v), (H, W)).astype(np.float32).copy()
    depth_m[:4, :4] = np.nan
    rgb = np.random.default_rng(0).integers(60, 200, (H, W, 3), dtype=np.uint8)
    return rgb, depth_m
