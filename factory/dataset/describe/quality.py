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


def noisiness(directory: Path, most: int = 200) -> dict[str, float]:
    """PSNR (dB), SSIM and GMSD of noisy against clean: mean and, as `NAME_std`, spread.

    Over whole pictures of (at most `most`) samples; NaN without any.
    """
    found: list[tuple[float, ...]] = []
    for shard in _shards(directory):
        for noisy, clean in zip(shard["noisy"], shard["clean"], strict=True):
            if len(found) < most:
                found.append((psnr_db(clean, noisy), ssim(clean, noisy), gmsd(clean, noisy)))
    values = np.array(found or [(np.nan,) * 3])
    made: dict[str, float] = {}
    for name, column in zip(("psnr_db", "ssim", "gmsd"), values.T, strict=True):
        made |= {name: float(column.mean()), f"{name}_std": float(column.std())}
    return made


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


def gmsd(clean: npt.NDArray[Any], noisy: npt.NDArray[Any]) -> float:
    """Gradient magnitude similarity deviation of two (H, W) uint8 or float (0..1) images.

    Xue et al. (2014), as the authors' program has it: of 2x2 means, Prewitt's gradients, c = 170
    for 255 grey values, zeros beyond the border.  0: identical.
    """
    one, other = (_gradient(255 * _unit(image)) for image in (clean, noisy))
    return float(((2 * one * other + 170) / (one**2 + other**2 + 170)).std())


def _gradient(image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    height, width = image.shape
    image = np.pad(image, ((0, height % 2), (0, width % 2)))
    image = image.reshape(len(image) // 2, 2, -1, 2).mean(axis=(1, 3))
    edge = np.pad(image, 1)
    across, down = edge[:, 2:] - edge[:, :-2], edge[2:] - edge[:-2]
    across = (across[:-2] + across[1:-1] + across[2:]) / 3
    down = (down[:, :-2] + down[:, 1:-1] + down[:, 2:]) / 3
    return np.asarray(np.hypot(across, down))


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
