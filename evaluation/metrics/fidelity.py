"""Full-reference metrics of (noisy or denoised) images against the clean one.

The functions take two grey images of one shape and an explicit `data_range` (255 for uint8, 1 for
floats in [0, 1]): guessed ranges are how an SSIM of .9995 gets published.  `mask`, where offered,
restricts the average to those pixels, for example to the sonar's sector.  `Reference` compares many
images with one clean image and does once what depends on that alone.
"""

from __future__ import annotations

import math
from functools import cached_property

import cv2
import numpy as np

from ...factory.common.array_types import Array, Bools, Float64s
from ...factory.common.errors import FactoryError
from ...factory.dataset.quality import (
    PSNR_CAP_DB,
    RADIUS_PX,
    SsimReference,
    decibels,
    gradient_magnitude,
    gradient_similarity,
    halved,
    inner,
)

SSIM_SMALLEST = 2 * RADIUS_PX + 1
"""Pixels a side: the window of SSIM must fit once."""

MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the five scales, the finest first (Wang et al. 2003, section 3.2)."""
MS_SSIM_SMALLEST = SSIM_SMALLEST << (len(MS_SSIM_WEIGHTS) - 1)
"""Pixels a side: the 11-pixel window must still fit into the fifth scale."""


class MetricError(FactoryError, ValueError):
    """The images cannot be compared: other shapes, NaN, too small, values beyond the data range."""


def checked_pair(
    reference: Array, image: Array, data_range: float, *, smallest: int = 1
) -> tuple[Float64s, Float64s]:
    """Both images as float64, or MetricError that says why they cannot be compared."""
    if not (math.isfinite(data_range) and data_range > 0):
        raise MetricError(f"data_range must be a positive number, got {data_range}")
    a = np.asarray(reference, np.float64)
    b = np.asarray(image, np.float64)
    if a.shape != b.shape:
        raise MetricError(f"images differ in shape: {a.shape} against {b.shape}")
    if a.ndim != 2:
        raise MetricError(f"expected a grey image (H, W), got shape {a.shape}")
    if min(a.shape) < smallest:
        raise MetricError(
            f"image of {a.shape[0]}x{a.shape[1]} is too small; at least {smallest} a side"
        )
    for name, values in (("reference", a), ("image", b)):
        low, high = float(values.min()), float(values.max())
        if not math.isfinite(low + high):
            raise MetricError(f"{name} has NaN or infinite pixels")
        # A denoiser may overshoot a little; a range that is off by a factor is a mistake.
        if high > 1.5 * data_range or low < -0.5 * data_range:
            raise MetricError(
                f"{name} has values {low:g}..{high:g}, which do not fit data_range {data_range:g}"
            )
    if data_range >= 100 and 0 < max(a.max(), b.max()) <= 1:
        raise MetricError(f"images have values 0..1 but data_range is {data_range:g}")
    return a, b


def checked_mask(mask: Bools, image: Array) -> Bools:
    """The mask as bool, or MetricError when it has another shape or no pixel."""
    mask = np.asarray(mask, dtype=bool)
    if mask.shape != image.shape:
        raise MetricError(f"mask is {mask.shape} but the image is {image.shape}")
    if not mask.any():
        raise MetricError("mask is empty; nothing to measure")
    return mask


class Reference:
    """A clean image (H, W) float64 of a data range; images beside it are checked by the caller."""

    def __init__(self, image: Float64s, data_range: float) -> None:
        self.image = image
        self.data_range = data_range
        self._ssim = SsimReference(image, data_range)

    def ssim_map(self, image: Float64s) -> Float64s:
        """(H, W) local structural similarity; Gaussian window of sigma 1.5."""
        luminance, structure = self._ssim.terms(image)
        return np.asarray(luminance * structure)

    def ms_ssim(self, image: Float64s) -> float:
        """Multi-scale SSIM in 0..1, 1 = identical (Wang, Simoncelli and Bovik 2003).

        Product over five scales of the mean contrast-structure term to the power MS_SSIM_WEIGHTS;
        the coarsest scale has the luminance term, too.  Only windows that fit wholly count; between
        scales the mean of 2x2 blocks, an odd last row or column left out.  A negative mean counts
        as 0, because it has no real power.  NaN below MS_SSIM_SMALLEST pixels a side.
        """
        if min(image.shape) < MS_SSIM_SMALLEST:
            return math.nan
        reference = self
        product = 1.0
        for scale, weight in enumerate(MS_SSIM_WEIGHTS):
            if scale:
                reference = reference._halved
                image = halved(_even_part(image))
            luminance, structure = reference._ssim.terms(image)
            last = scale == len(MS_SSIM_WEIGHTS) - 1
            terms = luminance * structure if last else structure
            product *= max(float(inner(terms).mean()), 0.0) ** weight
        return product

    def gms_map(self, image: Float64s, *, pooled: bool = True) -> Float64s:
        """(H, W), or (ceil(H/2), ceil(W/2)) if pooled: gradient magnitude similarity."""
        return gradient_similarity(self._own_gradients[pooled], self._gradients(image, pooled))

    def edges_kept(self, image: Float64s, mask: Bools | None = None) -> float:
        """Edge preservation index beta in -1..1, 1 = the edges of the clean image.

        The correlation of both images' high-pass parts, by the 3x3 Laplacian of four neighbours,
        the border of one pixel left out (Sattar et al. 1997).  It ignores gain and offset, so it
        sees edges and not brightness.  NaN when either image has no edge at all.
        """
        inside = np.zeros(image.shape, dtype=bool)
        inside[1:-1, 1:-1] = True
        if mask is not None:
            inside = checked_mask(mask & inside, image)
        own_edges, image_edges = (
            edges[inside] for edges in (self._laplacian, cv2.Laplacian(image, cv2.CV_64F))
        )
        own_edges = own_edges - own_edges.mean()
        image_edges = image_edges - image_edges.mean()
        norm = math.sqrt(float(own_edges @ own_edges) * float(image_edges @ image_edges))
        # A flat image leaves rounding errors of the Laplacian, which are no edges.
        least = 1e-16 * self.data_range**2 * own_edges.size
        return math.nan if norm < least else float(own_edges @ image_edges) / norm

    @cached_property
    def _halved(self) -> Reference:
        return Reference(halved(_even_part(self.image)), self.data_range)

    @cached_property
    def _laplacian(self) -> Float64s:
        return np.asarray(cv2.Laplacian(self.image, cv2.CV_64F), np.float64)

    @cached_property
    def _own_gradients(self) -> tuple[Float64s, Float64s]:
        return self._gradients(self.image, False), self._gradients(self.image, True)

    def _gradients(self, image: Float64s, pooled: bool) -> Float64s:
        grey = image * (255.0 / self.data_range)
        return gradient_magnitude(halved(grey) if pooled else grey)


def psnr(reference: Array, image: Array, *, data_range: float, mask: Bools | None = None) -> float:
    """Peak signal-to-noise ratio in dB, 10 log10(data_range^2 / MSE); inf for identical images."""
    a, b = checked_pair(reference, image, data_range)
    squared = np.square(a - b)
    chosen = squared if mask is None else squared[checked_mask(mask, a)]
    return decibels(float(np.mean(chosen)), data_range)


def finite_psnr(value_db: float) -> float:
    """`value_db` capped at PSNR_CAP_DB, so that one untouched image cannot make a mean infinite."""
    return min(value_db, PSNR_CAP_DB)


def ssim(reference: Array, image: Array, *, data_range: float, mask: Bools | None = None) -> float:
    """Mean structural similarity (Wang et al. 2004), the border of 5 pixels left out.

    It is scikit-image's with gaussian_weights=True, sigma=1.5, use_sample_covariance=False.
    """
    a, b = checked_pair(reference, image, data_range, smallest=SSIM_SMALLEST)
    return mean_ssim(Reference(a, data_range).ssim_map(b), mask)


def mean_ssim(similarity: Float64s, mask: Bools | None = None) -> float:
    """The SSIM of an `ssim_map`, over `mask` when one is given."""
    if mask is None:
        return float(inner(similarity).mean())
    chosen = inner(checked_mask(mask, similarity))
    if not chosen.any():
        raise MetricError("mask has no pixel further than 5 from the border; SSIM is undefined")
    return float(inner(similarity)[chosen].mean())


def deviation(similarity: Float64s, mask: Bools | None = None, *, pooled: bool = True) -> float:
    """The GMSD of a `gms_map`: its population standard deviation, over `mask` when one is given.

    0: identical images (Xue et al. 2014).  pooled: whether the map is of 2x2 blocks, as the
    authors' program has it; without, the formula is used as printed.  mask: of the whole image; a
    block counts when most of its pixels are in the mask.
    """
    if mask is None:
        return float(similarity.std())
    chosen = halved(mask.astype(np.float64)) > 0.5 if pooled else mask
    if not chosen.any():
        raise MetricError("mask has no block of pixels; GMSD is undefined")
    return float(similarity[chosen].std())


def shadow_iou(
    shadow: Bools, image: Array, *, threshold: float, sector: Bools | None = None
) -> float:
    """Intersection over union of the true shadow and of the shadow that `image` shows.

    shadow: (H, W) bool, the truth.  A pixel of `image` is shadow when it is <= `threshold`, inside
    `sector` (default: everywhere).  1.0 when neither has any shadow.
    """
    truth = shadow
    dark = image <= threshold
    if sector is not None:
        truth = truth & sector
        dark = dark & sector
    union = int((truth | dark).sum())
    return 1.0 if union == 0 else int((truth & dark).sum()) / union


def shadow_residual(shadow: Bools, image: Array) -> float:
    """Mean of `image`, in 0..1, inside the true shadow; NaN without a shadow."""
    inside = image[shadow].astype(np.float64)
    return float(inside.mean()) if inside.size else math.nan


def false_light_rate(shadow: Bools, image: Array, *, threshold: float) -> float:
    """Fraction of the true shadow's pixels that `image` lights above `threshold`; NaN without."""
    inside = image[shadow]
    return float((inside > threshold).mean()) if inside.size else math.nan


def _even_part(values: Float64s) -> Float64s:
    """The image without an odd last row or column."""
    height, width = (size // 2 * 2 for size in values.shape)
    return values[:height, :width]
