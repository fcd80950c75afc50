"""Pictures of scenes that stand still, with noise that changes from frame to frame."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

Gray = npt.NDArray[np.float32]

SHAPE = (120, 96)


def clean(seed: int) -> Gray:
    """Blobs on a grey floor, (H, W) in 0..1."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(0, 1, SHAPE).astype(np.float32)
    blobs = np.asarray(sum(size * cv2.GaussianBlur(noise, (0, 0), size) for size in (4.0, 8.0)))
    return np.asarray(np.clip(0.5 + 0.15 * blobs / blobs.std(), 0.1, 0.9), np.float32)


def frames(seed: int, count: int, noise: float = 0.08) -> list[npt.NDArray[np.uint8]]:
    """The scene so many times, (H, W) uint8, each with noise of its own."""
    rng = np.random.default_rng(1000 + seed)
    return [
        np.rint(np.clip(clean(seed) + rng.normal(0, noise, SHAPE), 0, 1) * 255).astype(np.uint8)
        for _ in range(count)
    ]


def shuffled(folder: Path, counts: dict[int, int]) -> Path:
    """Pictures of several scenes in one folder, in no order.  counts: seed -> frames."""
    pictures = [one for seed, count in counts.items() for one in frames(seed, count)]
    order = np.random.default_rng(0).permutation(len(pictures))
    folder.mkdir(parents=True)
    for number, place in enumerate(order):
        cv2.imwrite(str(folder / f"{number:03d}.png"), pictures[place])
    return folder
