"""What a finished dataset looks like in a few figures, for tables and messages."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

# Equal pictures count as this much, so that a mean stays finite.
PSNR_CAP_DB = 100.0


def noisiness(directory: Path, most: int = 200) -> dict[str, float]:
    """PSNR (dB) of noisy against clean: mean and spread over (at most `most`) whole pictures."""
    pictures = ((shard["noisy"], shard["clean"]) for shard in _shards(directory))
    both = (pair for stacks in pictures for pair in zip(*stacks, strict=True))
    found = [psnr_db(clean, noisy) for noisy, clean in islice(both, most)] or [np.nan]
    return {"psnr_db": float(np.mean(found)), "psnr_db_std": float(np.std(found))}


def psnr_db(clean: npt.NDArray[Any], noisy: npt.NDArray[Any]) -> float:
    """Peak signal-to-noise ratio of (H, W) uint8 (0..255) or float (0..1) images, dB, capped."""
    full_scale = 255.0 if clean.dtype == np.uint8 else 1.0
    difference = (noisy.astype(np.float64) - clean.astype(np.float64)) / full_scale
    mse = float(np.mean(difference**2))
    return float(min(PSNR_CAP_DB, -10 * np.log10(max(mse, 1e-10))))


def seen_sector_deg(directory: Path) -> tuple[float, float]:
    """Smallest and largest horizontal sector, degrees, that the camera saw of a sample."""
    spans = [
        shard["meta"]["azimuth_max_deg"] - shard["meta"]["azimuth_min_deg"]
        for shard in _shards(directory)
    ]
    joined = np.concatenate(spans)
    return float(joined.min()), float(joined.max())


def lit_share(directory: Path, most: int = 64) -> float:
    """Share of the pixels of (at most `most`) clean pictures that show an echo, 0 to 1."""
    pictures = (picture for shard in _shards(directory) for picture in shard["clean"])
    found = [float((picture > 0).mean()) for picture in islice(pictures, most)]
    return float(np.mean(found)) if found else 0.0


def _shards(directory: Path) -> Iterator[h5py.File]:
    for path in sorted(directory.glob("*/shard-*.h5")):
        with h5py.File(path) as shard:
            yield shard
