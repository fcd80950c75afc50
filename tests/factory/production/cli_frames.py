"""Frames for tests of the command line, and words that make it quick."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

FAST = ["render=analytic", "scheduler=serial", "dataset.preview_pairs=0"]


def write_frame(root: Path, name: str, depth_m: np.ndarray, scene="canyons/u_canyon") -> None:
    folder = root / scene
    (folder / "imgs").mkdir(parents=True, exist_ok=True)
    (folder / "depth").mkdir(parents=True, exist_ok=True)
    rgb = np.random.default_rng(0).integers(60, 200, (*depth_m.shape, 3), dtype=np.uint8)
    cv2.imwrite(str(folder / "imgs" / f"{name}.tiff"), rgb)
    cv2.imwrite(str(folder / "depth" / f"{name}_SeaErra_abs_depth.tif"), depth_m.astype(np.float32))


def ground(height=96, width=152) -> np.ndarray:
    v = np.arange(height)[:, None] / height
    return np.broadcast_to(1.5 / (0.15 + 0.5 * v), (height, width)).astype(np.float32)
