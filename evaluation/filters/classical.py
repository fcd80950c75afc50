"""Filters that every image library has, by one where it has them, and those of radar.

The speckle filters assume multiplicative noise of a known coefficient of variation (std / mean),
`noise_cv`; where the image varies no more it is smoothed, where it varies more it is left.
"""

from __future__ import annotations

import cv2
import numpy as np
from scipy import ndimage

from ...factory.common.array_types import Float32s, Float64s, UInt8s
from ..metrics.measure import Grey

_WHITE = np.float32(255)
_TINY = 1e-6  # of full scale: keeps black regions from dividing by zero


def identity(image: Grey) -> Grey:
    """The noisy image itself: the row `Origin`."""
    return image


def median(image: Grey, size: int) -> Grey:
    """Median of size x size pixels.

    An image of 256 levels goes through OpenCV, which gives the same in a fraction of the time.
    """
    whole = _levels(image)
    if size % 2 and np.array_equal(whole / _WHITE, image):
        return np.asarray(cv2.medianBlur(whole, size) / _WHITE)
    return np.asarray(ndimage.median_filter(image, size=size, mode="nearest"))


def gaussian(image: Grey, sigma_px: float) -> Grey:
    """Gaussian blur, cut at 4 sigma."""
    return np.asarray(ndimage.gaussian_filter(image, sigma_px, mode="nearest"))


def grey_opening(image: Grey, size: int) -> Grey:
    """Erosion, then dilation by a square (Serra 1982): removes bright specks smaller than it."""
    return np.asarray(ndimage.grey_opening(image, size=(size, size), mode="nearest"))


def bilateral(image: Grey, sigma_px: float, sigma_gray: float) -> Grey:
    """Bilateral filter (Tomasi and Manduchi 1998), OpenCV; window of 2 sigma to each side."""
    diameter = 2 * max(1, round(2 * sigma_px)) + 1
    return np.asarray(cv2.bilateralFilter(image, diameter, sigma_gray, sigma_px))


def nlm(image: Grey, strength: float) -> Grey:
    """Non-local means (Buades et al. 2005), OpenCV: 7x7 patches in a 21x21 window.

    OpenCV's takes 8 bits, so the image is rounded to 255 levels first.
    """
    result = cv2.fastNlMeansDenoising(_levels(image), None, strength * 255, 7, 21)
    return np.asarray(result / _WHITE)


def total_variation(image: Grey, weight: float) -> Grey:
    """Total variation of Rudin, Osher and Fatemi (1992) by Chambolle's algorithm, scikit-image."""
    from skimage.restoration import denoise_tv_chambolle  # slow to import

    result = denoise_tv_chambolle(image, weight=weight)  # type: ignore[no-untyped-call]
    return np.asarray(result, dtype=np.float32)


def _levels(image: Grey) -> UInt8s:
    """The nearest of 256 levels."""
    return np.asarray(np.rint(np.clip(image, 0, 1) * 255), dtype=np.uint8)


def wavelet(image: Grey, strength: float, levels: int) -> Grey:
    """Translation-invariant soft thresholding (Coifman and Donoho 1995) with the Haar wavelet.

    strength: the threshold as a grey value of the image.  A detail of level j averages 4^j
    pixels, where white noise is 2^j times weaker, and so is the threshold.
    """
    height, width = image.shape
    margin = 2**levels
    rest = _details(np.pad(image, margin, mode="symmetric"), strength, 0, levels)
    return rest[margin : margin + height, margin : margin + width]


def _details(smooth: Float32s, strength: float, level: int, levels: int) -> Float32s:
    """Split off one level, shrink its details, go on with the rest and put both together."""
    if level == levels:
        return smooth
    step = 2**level
    threshold = np.float32(strength / 2 ** (level + 1))
    low, high = _split(smooth, step, 0)
    bands = [*_split(low, step, 1), *_split(high, step, 1)]
    rest = _details(bands[0], strength, level + 1, levels)
    low_high, high_low, high_high = (
        np.sign(band) * np.maximum(np.abs(band) - threshold, 0) for band in bands[1:]
    )
    return _joined(_joined(rest, low_high, step, 1), _joined(high_low, high_high, step, 1), step, 0)


def _split(values: Float32s, step: int, axis: int) -> tuple[Float32s, Float32s]:
    """Half sum and half difference of each pixel and the one `step` before it, all round."""
    before = np.roll(values, step, axis)
    return (values + before) / 2, (values - before) / 2


def _joined(low: Float32s, high: Float32s, step: int, axis: int) -> Float32s:
    """The mean of the two ways back: each pixel is in a pair as the later and as the earlier."""
    return ((low + high) + np.roll(low - high, -step, axis)) / 2


def lee(image: Grey, size: int, noise_cv: float) -> Grey:
    """Lee (1980): mean + w (pixel - mean) with w = 1 - Cu^2 / Ci^2, at least 0."""
    mean, weight = _local(image, size, noise_cv)
    return _between(image, mean, weight)


def kuan(image: Grey, size: int, noise_cv: float) -> Grey:
    """Kuan et al. (1985): Lee's with w divided by 1 + Cu^2, the exact linear MMSE estimate."""
    mean, weight = _local(image, size, noise_cv)
    return _between(image, mean, weight / (1 + noise_cv**2))


def frost(image: Grey, size: int, damping: float) -> Grey:
    """Frost et al. (1982): mean of the window weighted by exp(-damping Ci^2 distance)."""
    _, squared_cv = _statistics(image, size)
    radius = size // 2
    height, width = image.shape
    around = np.pad(image.astype(np.float64), radius, mode="edge")
    total = np.zeros((height, width))
    weights = np.zeros((height, width))
    for row in range(size):
        for column in range(size):
            distance = np.hypot(row - radius, column - radius)
            weight = np.exp(-damping * distance * squared_cv)
            total += weight * around[row : row + height, column : column + width]
            weights += weight
    return np.asarray(total / weights, dtype=np.float32)


def srad(image: Grey, iterations: int, initial_cv: float, step: float, decay: float) -> Grey:
    """Speckle-reducing anisotropic diffusion (Yu and Acton 2002).

    initial_cv: q0, the speckle's coefficient of variation at the start; it falls as
    exp(-decay t).  step: of time, stable up to 0.25.  `iterations` steps are made; no flux crosses
    the border.
    """
    values = np.maximum(image.astype(np.float64), 1e-3)
    for number in range(iterations):
        north, south, west, east = _differences(values)
        gradient = (north**2 + south**2 + west**2 + east**2) / values**2
        laplace = (north + south + west + east) / values
        squared_q = np.maximum(0.5 * gradient - laplace**2 / 16, 0) / (1 + laplace / 4) ** 2
        squared_q0 = (initial_cv * np.exp(-decay * number * step)) ** 2
        spread = (squared_q - squared_q0) / (squared_q0 * (1 + squared_q0))
        # Below q0 the coefficient passes 1 (and its pole): there is speckle alone, so all diffuses.
        conduct = np.where(spread <= 0, 1.0, 1 / (1 + np.maximum(spread, 0)))
        below = np.concatenate([conduct[1:], conduct[-1:]])
        right = np.concatenate([conduct[:, 1:], conduct[:, -1:]], axis=1)
        flow = below * south + conduct * north + right * east + conduct * west
        values = np.maximum(values + step / 4 * flow, 1e-3)
    # The floor that kept the divisions possible is no echo.
    return np.asarray(np.where(values <= 1e-3, 0, values), dtype=np.float32)


def _statistics(image: Grey, size: int) -> tuple[Float64s, Float64s]:
    """Local mean and squared coefficient of variation."""
    values = image.astype(np.float64)
    mean = ndimage.uniform_filter(values, size, mode="nearest")
    variance = np.maximum(ndimage.uniform_filter(values**2, size, mode="nearest") - mean**2, 0)
    return mean, variance / np.maximum(mean, _TINY) ** 2


def _local(image: Grey, size: int, noise_cv: float) -> tuple[Float64s, Float64s]:
    """Local mean, and 1 - Cu^2 / Ci^2: 0 (all is noise) where nothing varies."""
    mean, squared_cv = _statistics(image, size)
    some = squared_cv > 1e-12
    return mean, np.asarray(1 - np.where(some, noise_cv**2 / np.where(some, squared_cv, 1), 1.0))


def _between(image: Grey, mean: Float64s, weight: Float64s) -> Grey:
    mixed = mean + np.clip(weight, 0, 1) * (image - mean)
    return np.asarray(mixed, dtype=np.float32)


def _differences(values: Float64s) -> tuple[Float64s, Float64s, Float64s, Float64s]:
    """Neighbour minus pixel to the north, south, west and east, 0 across the border."""
    around = np.pad(values, 1, mode="edge")
    return (
        around[:-2, 1:-1] - values,
        around[2:, 1:-1] - values,
        around[1:-1, :-2] - values,
        around[1:-1, 2:] - values,
    )
