"""Full-reference metrics of (noisy or denoised) images against the clean one.

Every function takes two gray images of one shape and an explicit `data_range` (255 for uint8, 1 for
floats in [0, 1]): guessed ranges are how an SSIM of .9995 gets published.  `mask`, where offered,
restricts the average to those pixels, for example to the sonar's sector.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ...factory.dataset.describe.similarity import RADIUS_PX, inner
from .checks import Image as Image
from .checks import Mask as Mask
from .checks import MetricError as MetricError
from .checks import checked_mask, checked_pair
from .reference import Compared, Reference, mean_of_blocks

PSNR_CAP_DB = 100.0
"""What a pair of identical images (infinite PSNR) counts as in a mean; see `finite_psnr`."""

SSIM_SMALLEST = 2 * RADIUS_PX + 1
"""Pixels a side: the window of SSIM must fit once."""

GMSD_SMALLEST = 6
"""Pixels a side of the pooled GMSD: three blocks for Prewitt's kernel."""


MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the five scales, the finest first (Wang et al. 2003, section 3.2)."""

MS_SSIM_SMALLEST = 176
"""Pixels a side: the 11-pixel window must still fit into the fifth scale."""


def psnr(reference: Image, image: Image, *, data_range: float, mask: Mask | None = None) -> float:
    """Peak signal-to-noise ratio in dB, 10 log10(data_range^2 / MSE); inf for identical images."""
    a, b = checked_pair(reference, image, data_range, smallest=1)
    squared = np.square(a - b)
    return decibels(
        float(np.mean(squared if mask is None else squared[checked_mask(mask, a)])), data_range
    )


def decibels(squared_error: float, data_range: float) -> float:
    """The PSNR in dB that a mean squared error stands for; inf for none."""
    return math.inf if squared_error == 0 else 10 * math.log10(data_range**2 / squared_error)


def finite_psnr(value_db: float) -> float:
    """`value_db` capped at PSNR_CAP_DB, so that one untouched image cannot make a mean infinite."""
    return min(value_db, PSNR_CAP_DB)


def ssim_map(reference: Image, image: Image, *, data_range: float) -> npt.NDArray[np.float64]:
    """(H, W) local structural similarity; Gaussian window of sigma 1.5, population covariance."""
    a, b = checked_pair(reference, image, data_range, smallest=SSIM_SMALLEST)
    return Reference(a, data_range).ssim_map(b)


def ssim(reference: Image, image: Image, *, data_range: float, mask: Mask | None = None) -> float:
    """Mean structural similarity (Wang et al. 2004), the border of 5 pixels left out.

    It is scikit-image's with gaussian_weights=True, sigma=1.5, use_sample_covariance=False.
    """
    return mean_ssim(ssim_map(reference, image, data_range=data_range), mask)


def mean_ssim(similarity: npt.NDArray[np.float64], mask: Mask | None = None) -> float:
    """The SSIM of an `ssim_map`, over `mask` when one is given."""
    if mask is None:
        return float(inner(similarity).mean())
    chosen = inner(checked_mask(mask, similarity))
    if not chosen.any():
        raise MetricError("mask has no pixel further than 5 from the border; SSIM is undefined")
    return float(inner(similarity)[chosen].mean())


def ms_ssim(reference: Image, image: Image, *, data_range: float) -> float:
    """Multi-scale SSIM in 0..1, 1 = identical (Wang, Simoncelli and Bovik 2003).

    Product over five scales of the mean contrast-structure term to the power MS_SSIM_WEIGHTS; the
    coarsest scale has the luminance term, too.  Window: Gaussian, sigma 1.5, 11 pixels, only where
    it fits wholly; between scales the mean of 2x2 blocks, an odd last row or column left out.  A
    negative mean counts as 0, because it has no real power.  MetricError below MS_SSIM_SMALLEST
    pixels a side.
    """
    a, b = checked_pair(reference, image, data_range, smallest=MS_SSIM_SMALLEST)
    return ms_ssim_of(Compared(Reference(a, data_range), b))


def ms_ssim_of(compared: Compared) -> float:
    """The same for an image that was checked already."""
    product = 1.0
    for scale, weight in enumerate(MS_SSIM_WEIGHTS):
        if scale:
            compared = compared.halved
        luminance, structure = compared.terms
        last = scale == len(MS_SSIM_WEIGHTS) - 1
        terms = luminance * structure if last else structure
        mean = float(inner(terms).mean())
        product *= max(mean, 0.0) ** weight
    return product


def gms_map(
    reference: Image, image: Image, *, data_range: float, pooled: bool = True
) -> npt.NDArray[np.float64]:
    """Local gradient magnitude similarity (Xue et al. 2014), in (0, 1].

    Gray values are put on the 0..255 scale that the constant c = 170 belongs to.  `pooled` takes
    the mean of 2x2 blocks first, as the authors' program does ((ceil(H/2), ceil(W/2)) out); without
    it the formula is used as printed ((H, W) out).  Beyond the border all is 0, as in conv2 'same'.
    """
    smallest = GMSD_SMALLEST if pooled else 3
    a, b = checked_pair(reference, image, data_range, smallest=smallest)
    return Reference(a, data_range).gms_map(b, pooled=pooled)


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
    chosen = mean_of_blocks(mask.astype(np.float64)) > 0.5 if pooled else mask
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
    truth, dark = shadow.astype(bool), image <= threshold
    if sector is not None:
        truth, dark = truth & sector, dark & sector
    union = int((truth | dark).sum())
    return 1.0 if union == 0 else int((truth & dark).sum()) / union


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
