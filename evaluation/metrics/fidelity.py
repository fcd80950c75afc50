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
from ...factory.dataset.quality import RADIUS_PX, SsimReference, inner

PSNR_CAP_DB = 100.0
"""What a pair of identical images (infinite PSNR) counts as in a mean; see `finite_psnr`."""

SSIM_SMALLEST = 2 * RADIUS_PX + 1
"""Pixels a side: the window of SSIM must fit once."""

GMSD_C = 170.0
"""Constant of Xue et al. 2014, for grey values 0..255."""
GMSD_SMALLEST = 6
"""Pixels a side of the pooled GMSD: three blocks for Prewitt's kernel."""

MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the five scales, the finest first (Wang et al. 2003, section 3.2)."""
MS_SSIM_SMALLEST = 176
"""Pixels a side: the 11-pixel window must still fit into the fifth scale."""

_STEP = np.array([1.0, 0.0, -1.0])
_THIRD = np.full(3, 1 / 3)


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
        """(H, W) local structural similarity."""
        luminance, structure = self._ssim.terms(image)
        return np.asarray(luminance * structure)

    def ms_ssim(self, image: Float64s) -> float:
        """See the function of this name."""
        reference = self
        product = 1.0
        for scale, weight in enumerate(MS_SSIM_WEIGHTS):
            if scale:
                reference = reference._halved
                image = _halved(image)
            luminance, structure = reference._ssim.terms(image)
            last = scale == len(MS_SSIM_WEIGHTS) - 1
            terms = luminance * structure if last else structure
            product *= max(float(inner(terms).mean()), 0.0) ** weight
        return product

    def gms_map(self, image: Float64s, *, pooled: bool = True) -> Float64s:
        """(H, W) or (ceil(H/2), ceil(W/2)) gradient magnitude similarity."""
        own_gradients = self._own_gradients[pooled]
        image_gradients = self._gradients(image, pooled)
        return np.asarray(
            (2 * own_gradients * image_gradients + GMSD_C)
            / (image_gradients * image_gradients + (own_gradients * own_gradients + GMSD_C))
        )

    def edges_kept(self, image: Float64s, mask: Bools | None = None) -> float:
        """See `edge_preservation`."""
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
        return Reference(_halved(self.image), self.data_range)

    @cached_property
    def _laplacian(self) -> Float64s:
        return np.asarray(cv2.Laplacian(self.image, cv2.CV_64F), np.float64)

    @cached_property
    def _own_gradients(self) -> tuple[Float64s, Float64s]:
        return self._gradients(self.image, False), self._gradients(self.image, True)

    def _gradients(self, image: Float64s, pooled: bool) -> Float64s:
        """Length of the gradient by Prewitt's kernels divided by 3, zeros beyond the border."""
        grey = image * (255.0 / self.data_range)
        if pooled:
            grey = _mean_of_blocks(grey)
        parts = [
            cv2.sepFilter2D(grey, cv2.CV_64F, along, down, borderType=cv2.BORDER_CONSTANT)
            for along, down in ((_STEP, _THIRD), (_THIRD, _STEP))
        ]
        return np.asarray(cv2.magnitude(parts[0], parts[1]), dtype=np.float64)


def psnr(reference: Array, image: Array, *, data_range: float, mask: Bools | None = None) -> float:
    """Peak signal-to-noise ratio in dB, 10 log10(data_range^2 / MSE); inf for identical images."""
    a, b = checked_pair(reference, image, data_range)
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


def ssim_map(reference: Array, image: Array, *, data_range: float) -> Float64s:
    """(H, W) local structural similarity; Gaussian window of sigma 1.5, population covariance."""
    a, b = checked_pair(reference, image, data_range, smallest=SSIM_SMALLEST)
    return Reference(a, data_range).ssim_map(b)


def ssim(reference: Array, image: Array, *, data_range: float, mask: Bools | None = None) -> float:
    """Mean structural similarity (Wang et al. 2004), the border of 5 pixels left out.

    It is scikit-image's with gaussian_weights=True, sigma=1.5, use_sample_covariance=False.
    """
    return mean_ssim(ssim_map(reference, image, data_range=data_range), mask)


def mean_ssim(similarity: Float64s, mask: Bools | None = None) -> float:
    """The SSIM of an `ssim_map`, over `mask` when one is given."""
    if mask is None:
        return float(inner(similarity).mean())
    chosen = inner(checked_mask(mask, similarity))
    if not chosen.any():
        raise MetricError("mask has no pixel further than 5 from the border; SSIM is undefined")
    return float(inner(similarity)[chosen].mean())


def ms_ssim(reference: Array, image: Array, *, data_range: float) -> float:
    """Multi-scale SSIM in 0..1, 1 = identical (Wang, Simoncelli and Bovik 2003).

    Product over five scales of the mean contrast-structure term to the power MS_SSIM_WEIGHTS; the
    coarsest scale has the luminance term, too.  Window: Gaussian, sigma 1.5, 11 pixels, only where
    it fits wholly; between scales the mean of 2x2 blocks, an odd last row or column left out.  A
    negative mean counts as 0, because it has no real power.  MetricError below MS_SSIM_SMALLEST
    pixels a side.
    """
    a, b = checked_pair(reference, image, data_range, smallest=MS_SSIM_SMALLEST)
    return Reference(a, data_range).ms_ssim(b)


def gmsd(
    reference: Array,
    image: Array,
    *,
    data_range: float,
    pooled: bool = True,
    mask: Bools | None = None,
) -> float:
    """Gradient magnitude similarity deviation, 0 = identical (Xue et al. 2014).

    Grey values are put on the 0..255 scale that the constant c = 170 belongs to.  `pooled` takes
    the mean of 2x2 blocks first, as the authors' program does; without it the formula is used as
    printed.  Beyond the border all is 0, as in conv2 'same'.
    """
    a, b = checked_pair(reference, image, data_range, smallest=GMSD_SMALLEST if pooled else 3)
    similarity = Reference(a, data_range).gms_map(b, pooled=pooled)
    return deviation(similarity, None if mask is None else checked_mask(mask, a), pooled=pooled)


def deviation(similarity: Float64s, mask: Bools | None = None, *, pooled: bool = True) -> float:
    """The GMSD of a `gms_map`: its population standard deviation, over `mask` when one is given.

    mask: of the whole image; a pooled block counts when most of its pixels are in the mask.
    """
    if mask is None:
        return float(similarity.std())
    chosen = _mean_of_blocks(mask.astype(np.float64)) > 0.5 if pooled else mask
    if not chosen.any():
        raise MetricError("mask has no block of pixels; GMSD is undefined")
    return float(similarity[chosen].std())


def edge_preservation(
    reference: Array, image: Array, *, data_range: float, mask: Bools | None = None
) -> float:
    """Edge preservation index beta in -1..1, 1 = the edges of the clean image.

    The correlation of both images' high-pass parts, by the 3x3 Laplacian of four neighbours, the
    border of one pixel left out (Sattar et al. 1997).  It ignores gain and offset, so it sees edges
    and not brightness.  NaN when either image has no edge at all.
    """
    a, b = checked_pair(reference, image, data_range, smallest=3)
    return Reference(a, data_range).edges_kept(b, None if mask is None else checked_mask(mask, a))


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


def shadow_residual(shadow: Bools, image: Array, *, data_range: float) -> float:
    """Mean of `image` inside the true shadow as a fraction of the range; NaN without a shadow."""
    inside = image[shadow].astype(np.float64)
    return float(inside.mean() / data_range) if inside.size else math.nan


def false_light_rate(shadow: Bools, image: Array, *, threshold: float) -> float:
    """Fraction of the true shadow's pixels that `image` lights above `threshold`; NaN without."""
    inside = image[shadow]
    return float((inside > threshold).mean()) if inside.size else math.nan


def _halved(values: Float64s) -> Float64s:
    """Means of 2x2 blocks, an odd last row or column left out."""
    height, width = (size // 2 * 2 for size in values.shape)
    return _mean_of_blocks(values[:height, :width])


def _mean_of_blocks(grey: Float64s) -> Float64s:
    """Mean of 2x2 blocks; an odd size is filled up with a row or column of zeros."""
    height, width = grey.shape
    even = np.pad(grey, ((0, height % 2), (0, width % 2)))
    rows = even[0::2] + even[1::2]
    return np.asarray((rows[:, 0::2] + rows[:, 1::2]) * 0.25)
