"""What a finished dataset looks like in two figures, for tables and messages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np


def mean_psnr_db(directory: Path, most: int = 200) -> float:
    """Mean over (at most `most`) samples of the PSNR of noisy against clean, full frame, dB.

    Equal pictures count as 100 dB, so that the mean stays finite.
    """
    values: list[float] = []
    for shard in _shards(directory):
        for noisy, clean in zip(shard["noisy"], shard["clean"], strict=True):
            scale = 255.0 if noisy.dtype == np.uint8 else 1.0
            mse = np.mean(((noisy.astype(np.float64) - clean) / scale) ** 2)
            values.append(min(100.0, -10 * np.log10(max(mse, 1e-10))))
            if len(values) == most:
                return float(np.mean(values))
    return float(np.mean(values)) if values else float("nan")


def seen_sector_deg(directory: Path) -> tuple[float, float]:
    """Smallest and largest horizontal sector, degrees, that the camera saw of a sample."""
    spans = [
        shard["meta"]["azimuth_max_deg"] - shard["meta"]["azimuth_min_deg"]
        for shard in _shards(directory)
    ]
    joined = np.concatenate(spans)
    return float(joined.min()), float(joined.max())


def _shards(directory: Path) -> Iterator[h5py.File]:
    for path in sorted(directory.glob("*/shard-*.h5")):
        with h5py.File(path) as shard:
            yield shard
