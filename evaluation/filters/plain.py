"""Filters that every image library has, by one where it has them."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from .base import Gray

Floats = npt.NDArray[np.float32]

_WHITE = np.float32(255)


def identity(image: Gray) -> Gray:
    """The noisy image itself: the row `Origin`."""
    return image


def median(image: Gray, size: int) -> Gray:
    """Median of size x size pixels.

    A picture of 256 levels goes through OpenCV, which gives the same in a fraction of the time.
    """
    whole = _levels(image)
    if size % 2 and np.array_equal(whole / _WHITE, image):
        return np.asarray(cv2.medianBlur(whole, size) / _WHITE)
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
    result = cv2.fastNlMeansDenoising(_levels(image), None, strength * 255, 7, 21)
    return np.asarray(result / _WHITE)


def total_variation(image: Gray, weight: float) -> Gray:
    """Total variation of Rudin, Osher and Fatemi (1992) by Chambolle's algorithm, scikit-image."""
    from skimage.restoration import denoise_tv_chambolle  # slow to import

    result = denoise_tv_chambolle(image, weight=weight)  # type: ignore[no-untyped-call]
    return np.asarray(result, dtype=np.float32)


def _levels(image: Gray) -> npt.NDArray[np.uint8]:
    """The nearest of 256 levels."""
    return np.asarray(np.rint(np.clip(image, 0, 1) * 255), dtype=np.uint8)


def wavelet(image: Gray, strength: float, levels: int) -> Gray:
    """Translation-invariant soft thresholding (Coifman and Donoho 1995) with the Haar wavelet.

    strength: the threshold as a grey value of the picture.  A detail of level j averages 4^j
    pixels, where white noise is 2^j times weaker, and so is the threshold.
    """
    height, width = image.shape
    margin = 2**levels
    rest = _details(np.pad(image, margin, mode="symmetric"), strength, 0, levels)
    return rest[margin : margin + height, margin : margin + width]


def _details(smooth: Floats, strength: float, level: int, levels: int) -> Floats:
    """Split off one level, shrink its details, go on with the rest and put both together."""
    if level == levels:
        return smooth
    step, threshold = 2**level, np.float32(strength / 2 ** (level + 1))
    low, high = _split(smooth, step, 0)
    bands = [*_split(low, step, 1), *_split(high, step, 1)]
    rest = _details(bands[0], strength, level + 1, levels)
    low_high, high_low, high_high = (
        np.sign(band) * np.maximum(np.abs(band) - threshold, 0) for band in bands[1:]
    )
    return _joined(_joined(rest, low_high, step, 1), _joined(high_low, high_high, step, 1), step, 0)


def _split(values: Floats, step: int, axis: int) -> tuple[Floats, Floats]:
    """Half sum and half difference of each pixel and the one `step` before it, all round."""
    before = np.roll(values, step, axis)
    return (values + before) / 2, (values - before) / 2


def _joined(low: Floats, high: Floats, step: int, axis: int) -> Floats:
    """The mean of the two ways back: each pixel is in a pair as the later and as the earlier."""
    return ((low + high) + np.roll(low - high, -step, axis)) / 2
