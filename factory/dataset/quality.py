"""How noisy the images of a dataset are: PSNR, SSIM, GMSD; and how much of them is lit."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from ..common.array_types import Array, Float64s
from .schema import CHECKSUMS

PSNR_CAP_DB = 100.0
"""PSNR of identical images, so that a mean stays finite."""

SIGMA_PX = 1.5
RADIUS_PX = 5
"""Standard deviation and radius of the Gaussian window, which ends at 3.5 sigma."""
LUMINANCE_FLOOR = 0.01
CONTRAST_FLOOR = 0.03
"""K1 and K2 of the structural similarity (Wang et al. 2004), as parts of full scale."""
GMSD_C = 170.0
"""Constant of Xue et al. (2014), for grey values 0..255."""


def noisiness(directory: Path, most: int = 200) -> dict[str, float]:
    """PSNR (dB), SSIM and GMSD of noisy against clean: mean and, as `NAME_std`, spread.

    Over whole images of at most `most` samples, drawn evenly from all; NaN without any.
    """
    figures = [
        (psnr_db(clean, noisy), ssim(clean, noisy), gmsd(clean, noisy))
        for clean, noisy in _even_pairs(directory, most)
    ]
    values = np.array(figures or [(np.nan,) * 3])
    summary: dict[str, float] = {}
    for name, column in zip(("psnr_db", "ssim", "gmsd"), values.T, strict=True):
        summary[name] = float(column.mean())
        summary[f"{name}_std"] = float(column.std())
    return summary


def images_digest(directory: Path) -> str:
    """16 hexadecimal digits that equal datasets of images share, by their stored checksums."""
    digest = hashlib.blake2b(digest_size=8)
    for shard in _shards(directory):
        checksums = shard[CHECKSUMS][()]
        digest.update(repr(checksums.dtype.names).encode() + checksums.tobytes())
    return digest.hexdigest()


def psnr_db(clean: Array, noisy: Array) -> float:
    """Peak signal-to-noise ratio of (H, W) uint8 (0..255) or float (0..1) images, dB, capped."""
    squared_error = float(np.mean((_unit(noisy) - _unit(clean)) ** 2))
    return min(PSNR_CAP_DB, decibels(squared_error))


def decibels(squared_error: float, data_range: float = 1.0) -> float:
    """Return the PSNR, dB, of a mean squared error; inf for 0."""
    return math.inf if squared_error == 0 else -10 * math.log10(squared_error / data_range**2)


def ssim(clean: Array, noisy: Array) -> float:
    """Mean structural similarity (Wang et al. 2004) of two (H, W) uint8 or float (0..1) images.

    The border of 5 pixels is left out, as in reports.  NaN for images smaller than the window.
    """
    if min(clean.shape) < 2 * RADIUS_PX + 1:
        return float("nan")
    luminance, structure = SsimReference(_unit(clean), 1.0).terms(_unit(noisy))
    return float(inner(luminance * structure).mean())


def gmsd(clean: Array, noisy: Array) -> float:
    """Gradient magnitude similarity deviation of two (H, W) uint8 or float (0..1) images.

    Xue et al. (2014), as the authors' program has it: of 2x2 means, 0 for identical images.
    """
    gradients = (gradient_magnitude(halved(255 * _unit(image))) for image in (clean, noisy))
    return float(gradient_similarity(*gradients).std())


def gradient_similarity(first: Float64s, second: Float64s) -> Float64s:
    """(H, W) gradient magnitude similarity of two `gradient_magnitude`."""
    return np.asarray((2 * first * second + GMSD_C) / (first**2 + second**2 + GMSD_C))


def gradient_magnitude(grey: Float64s) -> Float64s:
    """(H, W) length of the gradient of grey values 0..255: Prewitt's kernels, zeros outside."""
    edge = np.pad(grey, 1)
    across = edge[:, 2:] - edge[:, :-2]
    down = edge[2:] - edge[:-2]
    across = (across[:-2] + across[1:-1] + across[2:]) / 3
    down = (down[:, :-2] + down[:, 1:-1] + down[:, 2:]) / 3
    return np.asarray(np.hypot(across, down))


def halved(image: Float64s) -> Float64s:
    """(ceil(H / 2), ceil(W / 2)) means of 2x2 blocks; odd sizes are padded by zeros."""
    height, width = image.shape
    even = np.pad(image, ((0, height % 2), (0, width % 2)))
    return np.asarray(even.reshape(len(even) // 2, 2, -1, 2).mean(axis=(1, 3)))


def seen_sector_deg(directory: Path) -> tuple[float, float]:
    """Smallest and largest horizontal sector, degrees, that the camera saw of a sample."""
    tables = (shard["meta"][()] for shard in _shards(directory))
    sector_deg = np.concatenate([t["azimuth_max_deg"] - t["azimuth_min_deg"] for t in tables])
    return float(sector_deg.min()), float(sector_deg.max())


def lit_share(directory: Path, most: int = 64) -> float:
    """Share of the pixels of clean images that show an echo, 0 to 1.

    Of at most `most` samples, drawn evenly from all; 0 without any.
    """
    shares = [np.mean(clean != 0) for clean, _ in _even_pairs(directory, most)]
    return float(np.mean(shares or [0.0]))


def _even_pairs(directory: Path, most: int) -> Iterator[tuple[Array, Array]]:
    """Clean and noisy images of at most `most` samples, evenly spread over all shards."""
    total = sum(len(shard["clean"]) for shard in _shards(directory))
    count = min(most, total)
    chosen = {number * total // count for number in range(count)}
    first = 0
    for shard in _shards(directory):
        rows = len(shard["clean"])
        for row in range(rows):
            if first + row in chosen:
                yield shard["clean"][row], shard["noisy"][row]
        first += rows


def _unit(image: Array) -> Float64s:
    return np.asarray(image.astype(np.float64) / (255.0 if image.dtype == np.uint8 else 1.0))


def _shards(directory: Path) -> Iterator[h5py.File]:
    for path in sorted(directory.glob("*/shard-*.h5")):
        with h5py.File(path) as shard:
            yield shard


class SsimReference:
    """One image (H, W) float64, and the half of the work that depends on it alone.

    data_range: the difference of the largest and the smallest value that there can be.
    """

    def __init__(self, image: Float64s, data_range: float) -> None:
        self.image = image
        self._c1 = (LUMINANCE_FLOOR * data_range) ** 2
        self._c2 = (CONTRAST_FLOOR * data_range) ** 2
        self._mean = window(image)
        self._mean_squared = self._mean * self._mean
        self._variance = window(image * image) - self._mean_squared

    def terms(self, image: Float64s) -> tuple[Float64s, Float64s]:
        """(H, W) luminance and contrast-structure terms of SSIM; borders are mirrored."""
        mean = window(image)
        variance = window(image * image)
        squared = mean * mean
        variance -= squared
        cross = window(self.image * image)
        product = self._mean * mean
        cross -= product
        luminance = (2 * product + self._c1) / (self._mean_squared + squared + self._c1)
        structure = (2 * cross + self._c2) / (self._variance + variance + self._c2)
        return luminance, structure


def inner(values: Array) -> Array:
    """(H, W) values without the border of 5 pixels that the window does not fit into."""
    return values[RADIUS_PX:-RADIUS_PX, RADIUS_PX:-RADIUS_PX]


def window(values: Float64s) -> Float64s:
    """(H, W) means under the Gaussian window, borders mirrored."""
    try:
        import cv2  # of the extra sonar
    except ImportError:
        # The same to rounding, and slower.
        weights = np.exp(-0.5 * (np.arange(-RADIUS_PX, RADIUS_PX + 1) / SIGMA_PX) ** 2)
        wide = np.pad(values, RADIUS_PX, mode="symmetric")
        for axis in (0, 1):
            views = np.lib.stride_tricks.sliding_window_view(wide, len(weights), axis=axis)
            wide = views @ (weights / weights.sum())
        return wide
    size = (2 * RADIUS_PX + 1,) * 2
    return np.asarray(cv2.GaussianBlur(values, size, SIGMA_PX, borderType=cv2.BORDER_REFLECT))
