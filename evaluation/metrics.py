"""Full-reference metrics of (noisy or denoised) images against the clean one.

Every function takes two gray images of one shape and an explicit `data_range` (255 for uint8, 1 for
floats in [0, 1]): guessed ranges are how an SSIM of .9995 gets published.  `mask`, where offered,
restricts the average to those pixels, for example to the sonar's sector.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from evaluation.checks import Image as Image
from evaluation.checks import Mask as Mask
from evaluation.checks import MetricError as MetricError
from evaluation.checks import checked_mask, checked_pair
from factory.errors import FactoryError

PSNR_CAP_DB = 100.0
"""What a pair of identical images (infinite PSNR) counts as in a mean; see `finite_psnr`."""

_SSIM_SIGMA = 1.5
_SSIM_RADIUS = 5  # of the Gaussian window that scikit-image cuts at 3.5 sigma
_GMSD_C = 170.0  # Xue et al. 2014, for gray values 0..255


def psnr(reference: Image, image: Image, *, data_range: float, mask: Mask | None = None) -> float:
    """Peak signal-to-noise ratio in dB, 10 log10(data_range^2 / MSE); inf for identical images."""
    a, b = checked_pair(reference, image, data_range, smallest=1)
    squared = np.square(a - b)
    error = float(np.mean(squared if mask is None else squared[checked_mask(mask, a)]))
    return math.inf if error == 0 else 10 * math.log10(data_range**2 / error)


def finite_psnr(value_db: float) -> float:
    """`value_db` capped at PSNR_CAP_DB, so that one untouched image cannot make a mean infinite."""
    return min(value_db, PSNR_CAP_DB)


def ssim_map(reference: Image, image: Image, *, data_range: float) -> npt.NDArray[np.float64]:
    """(H, W) local structural similarity; Gaussian window of sigma 1.5, population covariance."""
    try:
        from skimage.metrics import structural_similarity  # slow to import, not needed by `--help`
    except ImportError as error:
        raise FactoryError(
            'SSIM needs scikit-image: pip install "simnfnd[evaluation]" (or scikit-image)'
        ) from error
    a, b = checked_pair(reference, image, data_range, smallest=2 * _SSIM_RADIUS + 1)
    _, similarity = structural_similarity(  # type: ignore[no-untyped-call]
        a,
        b,
        data_range=data_range,
        gaussian_weights=True,
        sigma=_SSIM_SIGMA,
        use_sample_covariance=False,
        full=True,
    )
    return np.asarray(similarity, dtype=np.float64)


def ssim(reference: Image, image: Image, *, data_range: float, mask: Mask | None = None) -> float:
    """Mean structural similarity (Wang et al. 2004), the border of 5 pixels left out.

    It is scikit-image's with gaussian_weights=True, sigma=1.5, use_sample_covariance=False.
    """
    return mean_ssim(ssim_map(reference, image, data_range=data_range), mask)


def mean_ssim(similarity: npt.NDArray[np.float64], mask: Mask | None = None) -> float:
    """The SSIM of an `ssim_map`, over `mask` when one is given."""
    inner = (slice(_SSIM_RADIUS, -_SSIM_RADIUS),) * 2
    if mask is None:
        return float(similarity[inner].mean())
    chosen = checked_mask(mask, similarity)[inner]
    if not chosen.any():
        raise MetricError("mask has no pixel further than 5 from the border; SSIM is undefined")
    return float(similarity[inner][chosen].mean())


def gms_map(
    reference: Image, image: Image, *, data_range: float, pooled: bool = True
) -> npt.NDArray[np.float64]:
    """Local gradient magnitude similarity (Xue et al. 2014), in (0, 1].

    Gray values are put on the 0..255 scale that the constant c = 170 belongs to.  `pooled` takes
    the mean of 2x2 blocks first, as the authors' program does ((ceil(H/2), ceil(W/2)) out); without
    it the formula is used as printed ((H, W) out).  Beyond the border all is 0, as in conv2 'same'.
    """
    a, b = checked_pair(reference, image, data_range, smallest=6 if pooled else 3)
    gradients = []
    for gray in (a, b):
        gray = gray * (255.0 / data_range)
        if pooled:
            gray = _mean_of_blocks(gray)
        gradients.append(_prewitt_magnitude(gray))
    m_a, m_b = gradients
    return np.asarray((2 * m_a * m_b + _GMSD_C) / (np.square(m_a) + np.square(m_b) + _GMSD_C))


def gmsd(
    reference: Image,
    image: Image,
    *,
    data_range: float,
    pooled: bool = True,
    mask: Mask | None = None,
) -> float:
    """Gradient magnitude similarity deviation, 0 = identical (Xue et al. 2014); see `gms_map`."""
    similarity = gms_map(reference, image, data_range=data_range, pooled=pooled)
    if mask is not None:
        mask = checked_mask(mask, np.asarray(reference))
    return deviation(similarity, mask, pooled=pooled)


def deviation(
    similarity: npt.NDArray[np.float64], mask: Mask | None = None, *, pooled: bool = True
) -> float:
    """The GMSD of a `gms_map`: its population standard deviation, over `mask` when one is given.

    mask: of the whole image; a pooled block counts when most of its pixels are in the mask.
    """
    if mask is None:
        return float(similarity.std())
    chosen = _mean_of_blocks(mask.astype(np.float64)) > 0.5 if pooled else mask
    if not chosen.any():
        raise MetricError("mask has no block of pixels; GMSD is undefined")
    return float(similarity[chosen].std())


def shadow_iou(
    shadow: Mask, image: Image, *, threshold: float, sector: Mask | None = None
) -> float:
    """Intersection over union of the true shadow and of the shadow that `image` shows.

    shadow: (H, W) bool, the truth.  A pixel of `image` is shadow when it is <= `threshold`, inside
    `sector` (default: everywhere).  1.0 when neither has any shadow.
    """
    image = np.asarray(image)
    if shadow.shape != image.shape:
        raise MetricError(f"shadow is {shadow.shape} but the image is {image.shape}")
    truth, seen = shadow.astype(bool), image <= threshold
    if sector is not None:
        truth, seen = truth & sector, seen & sector
    union = int((truth | seen).sum())
    return 1.0 if union == 0 else int((truth & seen).sum()) / union


def shadow_residual(shadow: Mask, image: Image, *, data_range: float) -> float:
    """Mean of `image` inside the true shadow as a fraction of the range; NaN without a shadow."""
    image = np.asarray(image)
    if shadow.shape != image.shape:
        raise MetricError(f"shadow is {shadow.shape} but the image is {image.shape}")
    inside = image[shadow.astype(bool)].astype(np.float64)
    return float(inside.mean() / data_range) if inside.size else math.nan


def false_light_rate(shadow: Mask, image: Image, *, threshold: float) -> float:
    """Fraction of the true shadow's pixels that `image` lights above `threshold`; NaN without."""
    image = np.asarray(image)
    if shadow.shape != image.shape:
        raise MetricError(f"shadow is {shadow.shape} but the image is {image.shape}")
    inside = image[shadow.astype(bool)]
    return float((inside > threshold).mean()) if inside.size else math.nan


def _mean_of_blocks(gray: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Mean of 2x2 blocks; an odd size is filled up with a row or column of zeros."""
    height, width = gray.shape
    full = np.pad(gray, ((0, height % 2), (0, width % 2)))
    return np.asarray(full.reshape(full.shape[0] // 2, 2, full.shape[1] // 2, 2).mean(axis=(1, 3)))


def _prewitt_magnitude(gray: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Length of the gradient by Prewitt's kernels divided by 3, zeros beyond the border."""
    step, smooth = np.array([1.0, 0.0, -1.0]), np.full(3, 1 / 3)
    parts = []
    for axis in (0, 1):
        along = ndimage.correlate1d(gray, step, axis=axis, mode="constant")
        parts.append(ndimage.correlate1d(along, smooth, axis=1 - axis, mode="constant"))
    return np.asarray(np.hypot(parts[0], parts[1]))
