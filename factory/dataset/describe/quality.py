"""What a finished dataset looks like in a few figures, for tables and messages."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from .similarity import RADIUS_PX, SsimReference, inner

# Equal pictures count as this much, so that a mean stays finite.
PSNR_CAP_DB = 100.0


def mean_psnr_db(directory: Path, most: int = 200) -> float:
    """Mean over (at most `most`) samples of the PSNR of noisy against clean, full frame, dB."""
    values: list[float] = []
    for shard in _shards(directory):
        for noisy, clean in zip(shard["noisy"], shard["clean"], strict=True):
            values.append(psnr_db(clean, noisy))
            if len(values) == most:
                return float(np.mean(values))
    return float(np.mean(values)) if values else float("nan")


def psnr_db(clean: npt.NDArray[Any], noisy: npt.NDArray[Any]) -> float:
    """Peak signal-to-noise ratio of (H, W) uint8 (0..255) or float (0..1) images, dB, capped."""
    mse = float(np.mean((_unit(noisy) - _unit(clean)) ** 2))
    return float(min(PSNR_CAP_DB, -10 * np.log10(max(mse, 1e-10))))


def ssim(clean: npt.NDArray[Any], noisy: npt.NDArray[Any]) -> float:
    """Mean structural similarity (Wang et al. 2004) of two (H, W) uint8 or float (0..1) images.

    The border of 5 pixels is left out, as in reports.  NaN for images smaller than the window.
    """
    if min(clean.shape) < 2 * RADIUS_PX + 1:
        return float("nan")
    luminance, structure = SsimReference(_unit(clean), 1.0).terms(_unit(noisy))
    return float(inner(luminance * structure).mean())


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
    found: list[float] = []
    for shard in _shards(directory):
        found += [float((picture > 0).mean()) for picture in shard["clean"][: most - len(found)]]
        if len(found) >= most:
            break
    return float(np.mean(found)) if found else 0.0


def _unit(image: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    scale = 255.0 if image.dtype == np.uint8 else 1.0
    return np.asarray(image.astype(np.float64) / scale)


def _shards(directory: Path) -> Iterator[h5py.File]:
    for path in sorted(directory.glob("*/shard-*.h5")):
        with h5py.File(path) as shard:
            yield shard
