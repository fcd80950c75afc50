"""Static scenes, and noisy frames of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from simnfnd.factory.common.array_types import Float32s

SIDE = 64


def scene(seed: int, height: int = SIDE, width: int = SIDE) -> Float32s:
    """(H, W) float32 in 0..1: blobs of several sizes on a grey floor."""
    wide = np.random.default_rng(seed).normal(0, 1, (height, width)).astype(np.float32)
    actual = np.asarray(sum(size * cv2.GaussianBlur(wide, (0, 0), size) for size in (2.5, 5.0)))
    return np.asarray(np.clip(0.5 + 0.15 * actual / actual.std(), 0, 1), np.float32)


def noisy(of: Float32s, seed: int, noise: float = 0.08) -> Float32s:
    """The scene with fresh white noise."""
    observed = of + np.random.default_rng(1000 + seed).normal(0, noise, of.shape)
    return np.asarray(np.clip(observed, 0, 1), np.float32)


def write(path: Path, image: Float32s) -> None:
    """An image of 8 bits."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), np.rint(image * 255).astype(np.uint8))
