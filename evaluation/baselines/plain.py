"""Filters that every image library has."""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from evaluation.baselines.base import Gray


def identity(image: Gray) -> Gray:
    """The noisy image itself: the row `Origin`."""
    return image


def median(image: Gray, size: int) -> Gray:
    """Median of size x size pixels."""
    return np.asarray(ndimage.median_filter(image, size=size, mode="nearest"))


def gaussian(image: Gray, sigma_px: float) -> Gray:
    """Gaussian blur, cut at 4 sigma."""
    return np.asarray(ndimage.gaussian_filter(image, sigma_px, mode="nearest"))


def grey_opening(image: Gray, size: int) -> Gray:
    """Erosion, then dilation by a square (Serra 1982): removes bright specks smaller than it."""
    return np.asarray(ndimage.grey_opening(image, size=(size, size), mode="nearest"))


def bilateral(image: Gray, sigma_px: float, sigma_gray: float) -> Gray:
    """Bilateral filter (Tomasi and Manduchi 1998), OpenCV; window of 2 sigma to each side."""
    diameter = 2 * max(1, round(2 * sigma_px)) + 1
    return np.asarray(cv2.bilateralFilter(image, diameter, sigma_gray, sigma_px))


def nlm(image: Gray, strength: float) -> Gray:
    """Non-local means (Buades et al. 2005), OpenCV: 7x7 patches in a 21x21 window.

    OpenCV's takes 8 bits, so the picture is rounded to 255 levels first.
    """
    whole = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    result = cv2.fastNlMeansDenoising(whole, None, strength * 255, 7, 21)
    return np.asarray(result, dtype=np.float32) / 255


def total_variation(image: Gray, weight: float) -> Gray:
    """Total variation of Rudin, Osher and Fatemi (1992) by Chambolle's algorithm, scikit-image."""
    from skimage.restoration import denoise_tv_chambolle  # slow to import

    result = denoise_tv_chambolle(image, weight=weight)  # type: ignore[no-untyped-call]
    return np.asarray(result, dtype=np.float32)
