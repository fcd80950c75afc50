"""MS-SSIM: structural similarity seen from five distances."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from evaluation.checks import Image, checked_pair

WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the five scales, the finest first (Wang et al. 2003, section 3.2)."""

SMALLEST = 176
"""Pixels a side: the 11-pixel window must still fit into the fifth scale."""

_SIGMA, _RADIUS = 1.5, 5
_K1, _K2 = 0.01, 0.03


def ms_ssim(reference: Image, image: Image, *, data_range: float) -> float:
    """Multi-scale SSIM in 0..1, 1 = identical (Wang, Simoncelli and Bovik 2003).

    Product over five scales of the mean contrast-structure term to the power WEIGHTS; the coarsest
    scale has the luminance term, too.  Window: Gaussian, sigma 1.5, 11 pixels, only where it fits
    wholly; between scales the mean of 2x2 blocks, an odd last row or column left out.  A negative
    mean counts as 0, because it has no real power.  MetricError below SMALLEST pixels a side.
    """
    a, b = checked_pair(reference, image, data_range, smallest=SMALLEST)
    product = 1.0
    for scale, weight in enumerate(WEIGHTS):
        if scale:
            a, b = _halved(a), _halved(b)
        luminance, structure = _terms(a, b, data_range)
        last = scale == len(WEIGHTS) - 1
        term = float(np.mean(luminance * structure if last else structure))
        product *= max(term, 0.0) ** weight
    return product


def _terms(
    a: npt.NDArray[np.float64], b: npt.NDArray[np.float64], data_range: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Luminance and contrast-structure maps where the window fits."""
    mean_a, mean_b = _window(a), _window(b)
    variances = _window(a * a) - mean_a**2 + _window(b * b) - mean_b**2
    covariance = _window(a * b) - mean_a * mean_b
    c1, c2 = (_K1 * data_range) ** 2, (_K2 * data_range) ** 2
    luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
    return luminance, (2 * covariance + c2) / (variances + c2)


def _window(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    smooth = ndimage.gaussian_filter(values, _SIGMA, radius=_RADIUS)
    return np.asarray(smooth[_RADIUS:-_RADIUS, _RADIUS:-_RADIUS])


def _halved(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    height, width = (size // 2 * 2 for size in values.shape)
    blocks = values[:height, :width].reshape(height // 2, 2, width // 2, 2)
    return np.asarray(blocks.mean(axis=(1, 3)))
