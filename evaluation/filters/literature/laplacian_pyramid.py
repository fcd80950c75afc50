"""LPMsDE: denoising in a Laplacian pyramid, after the abstract.

Only the abstract (IEEE Access 2023, 3335372) is public, so this is what it names and no more: a
Laplacian pyramid, the noise variance estimated from it, an adaptive filter of Lee's kind on every
level.  Its last step, an equalisation of contrast, is left out.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ..base import Gray

Floats = npt.NDArray[np.float32]

_WINDOW = 5
_GAUSSIAN_MAD = 0.6745  # median of |N(0, 1)|


def lpmsde(image: Gray, strength: float, levels: int) -> Gray:
    """(H, W) in 0..1 denoised.  strength: multiple of the estimated noise variance."""
    bands, rest = _pyramid(image, levels)
    kept = [_lee_band(band, strength * _noise_variance(band)) for band in bands]
    for band in reversed(kept):
        rest = _enlarged(rest, band) + band
    return np.clip(rest, 0, 1)


def _pyramid(image: Gray, levels: int) -> tuple[list[Floats], Floats]:
    """Band-pass levels, the finest first, and the coarse rest (Burt and Adelson 1983)."""
    bands, current = [], image
    for _ in range(levels):
        smaller = np.asarray(cv2.pyrDown(current), dtype=np.float32)
        bands.append(current - _enlarged(smaller, current))
        current = smaller
    return bands, current


def _enlarged(small: Floats, like: Floats) -> Floats:
    return np.asarray(cv2.pyrUp(small, dstsize=like.shape[::-1]), dtype=np.float32)


def _noise_variance(band: Floats) -> float:
    """Robust variance of a level, of what is not exactly 0 (outside of the fan)."""
    some = np.abs(band[np.abs(band) > 1e-6])
    return float((np.median(some) / _GAUSSIAN_MAD) ** 2) if some.size else 0.0


def _lee_band(band: Floats, noise: float) -> Floats:
    """Each coefficient times the part of its neighbourhood's power that is not noise."""
    power = ndimage.uniform_filter(band * band, _WINDOW, mode="nearest")
    part = np.maximum(power - noise, 0) / np.maximum(power, 1e-12)
    return np.asarray(band * part, dtype=np.float32)
