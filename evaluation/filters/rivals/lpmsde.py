"""LPMsDE, after the abstract: an adaptive filter on each level of a Laplacian pyramid.

IEEE Access 11 (2023), 3335372; the SimNFND paper compares with it in Figure 14.  Only the abstract
was at hand.  It names a Laplacian pyramid, the noise variance estimated from it, an adaptive filter
and an equalisation of contrast, which is left out here because it is no denoising.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from ....factory.common.array_types import Float32s
from ...metrics.measure import Grey

_WINDOW_PX = 5
_NORMAL_MEDIAN = 0.6745  # median magnitude of a normal variable of deviation 1


def lpmsde(image: Grey, strength: float, levels: int) -> Grey:
    """(H, W) in 0..1 denoised.  strength: multiple of the estimated noise variance."""
    bands, coarse = build_pyramid(image, levels)
    for band in reversed(bands):
        noise_variance = strength * _estimate_variance(band)
        coarse = _enlarge(coarse, band.shape) + _filter_band(band, noise_variance)
    return np.clip(coarse, 0, 1)


def build_pyramid(image: Grey, levels: int) -> tuple[list[Float32s], Float32s]:
    """Band-pass levels, the finest first, and the coarse rest (Burt and Adelson 1983)."""
    bands: list[Float32s] = []
    current = image
    for _ in range(levels):
        smaller = np.asarray(cv2.pyrDown(current), np.float32)
        bands.append(current - _enlarge(smaller, current.shape))
        current = smaller
    return bands, current


def _enlarge(image: Float32s, shape: tuple[int, ...]) -> Float32s:
    return np.asarray(cv2.pyrUp(image, dstsize=shape[::-1]), np.float32)


def _estimate_variance(band: Float32s) -> float:
    """Robust noise variance of a level; exact zeros, outside the fan, do not count."""
    magnitudes = np.abs(band[np.abs(band) > 1e-6])
    if not magnitudes.size:
        return 0.0
    return float((np.median(magnitudes) / _NORMAL_MEDIAN) ** 2)


def _filter_band(band: Float32s, noise_variance: float) -> Float32s:
    """Each coefficient times the share of its neighbourhood's power that is not noise."""
    power = ndimage.uniform_filter(band * band, _WINDOW_PX, mode="nearest")
    share = np.maximum(power - noise_variance, 0) / np.maximum(power, 1e-12)
    return np.asarray(band * share, np.float32)
