"""A pair in memory, and everything that is measured of an image beside its clean one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Array, Bools, Float32s, Float64s, Floats, Int64s
from ...factory.dataset.quality import decibels
from . import fidelity as metrics

Grey = Float32s
"""(H, W) in 0..1, 0 = no echo."""

Figures = dict[str, float]
"""Metric -> value; NaN where it does not exist.  `_fan`: inside the sonar's sector alone."""


class Metric(NamedTuple):
    """How tables show a metric.

    label: name with the unit.  digits: digits after the point.
    better: 1 where high values are better, -1 where low ones are, 0 where neither is.
    """

    label: str
    digits: int = 3
    better: int = 0


METRICS = {
    "psnr": Metric("PSNR, dB", 2, 1),
    "ssim": Metric("SSIM", 3, 1),
    "gmsd": Metric("GMSD", 3, -1),
    "psnr_fan": Metric("PSNR fan only, dB", 2, 1),
    "ssim_fan": Metric("SSIM fan only", 3, 1),
    "gmsd_fan": Metric("GMSD fan only", 3, -1),
    "shadow_iou": Metric("shadow IoU", 3, 1),
    "shadow_residual": Metric("shadow residual", 4, -1),
    "false_light_rate": Metric("false-light rate", 3, -1),
    "gmsd_unpooled": Metric("GMSD as printed", 3, -1),
    "ms_ssim": Metric("MS-SSIM", 3, 1),
    "edge_preservation": Metric("edges", 3, 1),
    "enl": Metric("ENL", 2),
    "cnr": Metric("CNR", 2, 1),
    "ratio_mean": Metric("ratio mean"),
    "ratio_variance": Metric("ratio variance"),
    "ratio_correlation": Metric("ratio correlation"),
}
"""Metrics of a pair, in the order of the tables.

ENL rewards blur, and doing nothing leaves a perfect ratio image: neither ranks methods alone."""

SHADOW = 0.02
"""A pixel counts as shadow at or below this fraction of full scale."""
SIDE = 16
"""Edge of an even zone, pixels."""
_DARK = 0.01  # of full scale: below, a ratio says nothing
_BEYOND_GRAIN = 4
"""Pixels over which a ratio image is compared with itself: grain of sonars is narrower."""
_MEDIAN_PX = 15  # window of the median filter that separates dark from bright ground
_DARK_SHARE = 0.1  # darkest part of the sector
_NO_POWER = 1e-20  # of a ratio image: less is rounding


@dataclass(frozen=True)
class PairImages:
    """The images of a pair.

    noisy, clean: (H, W) float32 in 0..1.  shadow, sector: (H, W) bool.
    """

    noisy: Grey
    clean: Grey
    shadow: Bools
    sector: Bools


def sector_of(noisy: Array, clean: Array, shadow: Bools) -> Bools:
    """(H, W) bool: the pixels where the sonar could have measured anything.

    The shadow mask is confined to the sector, and every other pixel of it carries an echo.
    """
    return np.asarray(shadow | (clean > 0) | (noisy > 0))


@dataclass(frozen=True)
class Levels:
    """One global gain and offset: out = gain * image + offset, clipped to 0..1."""

    gain: float
    offset: float

    def __call__(self, image: Floats) -> Grey:
        """The corrected image, same shape, float32 in 0..1."""
        return np.clip(self.gain * image + self.offset, 0, 1).astype(np.float32)


def fit_levels(pairs: Iterable[tuple[Floats, Floats]]) -> Levels:
    """The least-squares gain and offset from (image, clean) pairs, over all pixels of all pairs.

    A constant image leaves only the offset, the mean of the clean ones.
    """
    sums = np.zeros(5)
    for image, clean in pairs:
        x = image.astype(np.float64).ravel()
        y = clean.astype(np.float64).ravel()
        sums += np.array([x.size, x.sum(), y.sum(), x @ x, x @ y])
    mean_x, mean_y, mean_xx, mean_xy = sums[1:] / sums[0]
    variance = mean_xx - mean_x**2
    if variance < 1e-12:
        return Levels(0.0, float(mean_y))
    gain = (mean_xy - mean_x * mean_y) / variance
    return Levels(float(gain), float(mean_y - gain * mean_x))


def with_levels(image: Grey, reference: Grey, mask: Bools) -> Grey:
    """The image with the gain and offset that bring it closest to the reference in the mask."""
    return fit_levels([(image[mask], reference[mask])])(image)


class MeasuredPair:
    """A pair, checked, and what the metrics of all methods on it share."""

    def __init__(self, pair: PairImages) -> None:
        """Raises MetricError for a pair without anything to measure."""
        if not pair.sector.any():
            raise metrics.MetricError("clean, noisy and shadow are empty; nothing to measure")
        self.pair = pair
        self.reference = metrics.Reference(pair.clean.astype(np.float64), 1.0)

    def figures(self, image: Array) -> Figures:
        """All metrics of an image (H, W) in 0..1; NaN where one does not exist.

        Raises MetricError where it cannot be measured.
        """
        pair = self.pair
        reference = self.reference
        _, values = metrics.checked_pair(pair.clean, image, 1.0, smallest=metrics.SSIM_SMALLEST)
        squared = np.square(reference.image - values)
        similarity = reference.ssim_map(values)
        gradients = reference.gms_map(values)
        return {
            "psnr": decibels(float(squared.mean())),
            "ssim": metrics.mean_ssim(similarity),
            "gmsd": metrics.deviation(gradients),
            "psnr_fan": decibels(float(squared[pair.sector].mean())),
            "ssim_fan": metrics.mean_ssim(similarity, pair.sector),
            "gmsd_fan": metrics.deviation(gradients, pair.sector),
            "shadow_iou": metrics.shadow_iou(
                pair.shadow, image, threshold=SHADOW, sector=pair.sector
            ),
            "shadow_residual": metrics.shadow_residual(pair.shadow, image),
            "false_light_rate": metrics.false_light_rate(pair.shadow, image, threshold=SHADOW),
            "gmsd_unpooled": metrics.deviation(reference.gms_map(values, pooled=False)),
            "ms_ssim": reference.ms_ssim(values),
            "edge_preservation": reference.edges_kept(values, pair.sector),
            "enl": enl(values, self._zones),
            "cnr": contrast_to_noise(
                values, pair.sector & ~pair.shadow & (pair.clean > 0), pair.shadow
            ),
            **ratio_figures(pair.noisy, values),
        }

    @cached_property
    def _zones(self) -> Int64s:
        """The even zones of the clean image, the same for all methods."""
        return homogeneous_zones(self.pair.clean, data_range=1.0, sector=self.pair.sector)


class MeasuredImage:
    """A noisy image of a real sonar, and its regions, in which all outputs are measured.

    sector: (H, W) bool, the insonified part.  dark, bright: (H, W) bool, dark and bright ground.
    """

    def __init__(self, noisy: Grey, sector: Bools) -> None:
        """Raises MetricError for an image that is black or too small."""
        if min(noisy.shape) < SIDE or not sector.any() or not noisy[sector].any():
            raise metrics.MetricError(f"black, or smaller than {SIDE} pixels")
        self.noisy = noisy
        self.sector = sector
        levels = np.rint(np.clip(noisy, 0, 1) * 255).astype(np.uint8)
        smooth = cv2.medianBlur(levels, _MEDIAN_PX)
        # Near the edge of the sector the median sees black that is no shadow.
        window = np.ones((_MEDIAN_PX, _MEDIAN_PX), np.uint8)
        inner = cv2.erode(sector.astype(np.uint8), window).astype(bool)
        if not inner.any():
            inner = sector
        low, middle = np.quantile(smooth[inner], (_DARK_SHARE, 0.5))
        self.dark = inner & (smooth <= low)
        self.bright = inner & (smooth > max(low, middle))
        self._reference = metrics.Reference(noisy.astype(np.float64), 1.0)
        self._zones = homogeneous_zones(noisy, data_range=1.0, sector=sector)

    def figures(self, image: Grey) -> Figures:
        """The figures without a truth of an image, (H, W) in 0..1; NaN where one is undefined."""
        _, values = metrics.checked_pair(self.noisy, image, 1.0)
        return {
            "enl": enl(image, self._zones),
            "cnr": contrast_to_noise(image, self.bright, self.dark),
            "edges_kept": self._reference.edges_kept(values, self.sector),
            **ratio_figures(self.noisy, image, self.sector),
        }


def likeness(image: Grey, reference: Grey, mask: Bools, *, levels: bool = True) -> Figures:
    """PSNR (dB) and SSIM of an image against its reference where the mask is.

    levels: whether one gain and offset is fitted first.
    """
    if levels:
        image = with_levels(image, reference, mask)
    return {
        "psnr": metrics.finite_psnr(metrics.psnr(reference, image, data_range=1.0, mask=mask)),
        "ssim": metrics.ssim(reference, image, data_range=1.0, mask=mask),
    }


def homogeneous_zones(
    image: Array, *, data_range: float, sector: Bools, share: float = 0.1
) -> Int64s:
    """(N, 2) top-left corners of the image's most even blocks, the evenest first.

    Blocks of 16x16 pixels on a grid without overlap, wholly inside `sector` and with a mean above
    5 % of full scale (shadow is even, too, but has no speckle); of these the `share` (at least one)
    with the least std/mean.  Choose them on the clean image where there is one, so that all methods
    are measured in the same places.  Empty when no block qualifies.
    """
    rows, columns = (size // SIDE for size in image.shape)

    def blocks(array: Array) -> Array:
        cut = array[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE)
        return cut.transpose(0, 2, 1, 3).reshape(rows * columns, SIDE * SIDE)

    values = blocks(image.astype(np.float64))
    mean = values.mean(axis=1)
    deviation = values.std(axis=1)
    (usable,) = np.nonzero(blocks(sector).all(axis=1) & (mean > 0.05 * data_range))
    if not usable.size:
        return np.empty((0, 2), dtype=np.int64)
    count = max(1, round(share * usable.size))
    order = np.argsort(deviation[usable] / mean[usable], kind="stable")[:count]
    chosen = usable[order]
    corners = np.stack([chosen // columns * SIDE, chosen % columns * SIDE], axis=1)
    return np.asarray(corners, dtype=np.int64)


def enl(image: Array, zones: Int64s) -> float:
    """Median over the zones of the equivalent number of looks, mean^2 / variance.

    NaN without zones, inf where all is equal.  Blur alone raises it: never read it alone.
    """
    if not len(zones):
        return math.nan
    offsets = np.arange(SIDE)
    rows = zones[:, :1] + offsets
    columns = zones[:, 1:] + offsets
    blocks = image[rows[:, :, None], columns[:, None, :]].reshape(len(zones), -1).astype(float)
    squared = blocks.mean(axis=1) ** 2
    variance = blocks.var(axis=1)
    # The variance of a constant is rounding alone.
    some = variance > 1e-20 * squared
    looks: Float64s = np.where(some, squared / np.where(some, variance, 1.0), math.inf)
    return float(np.median(looks))


def contrast_to_noise(image: Array, bright: Bools, dark: Bools) -> float:
    """CNR of two regions, |m1 - m2| / sqrt(v1 + v2) with population variances (linear, not dB).

    Here `bright` is the insonified seabed and `dark` the true shadow.  NaN when a region is empty,
    inf when both are constant and differ.
    """
    grey = np.asarray(image, dtype=np.float64)
    bright_values = grey[bright]
    dark_values = grey[dark]
    if not bright_values.size or not dark_values.size:
        return math.nan
    difference = abs(float(bright_values.mean() - dark_values.mean()))
    noise = math.sqrt(float(bright_values.var() + dark_values.var()))
    if noise == 0:
        return math.inf if difference else 0.0
    return difference / noise


def ratio_figures(noisy: Array, denoised: Array, region: Bools | None = None) -> Figures:
    """Mean, variance and spatial correlation of the ratio image, noisy / denoised.

    noisy, denoised: in 0..1.  region: what counts; None: all.  Pixels where denoised is below 1 %
    of full scale are left out.  What was removed should be noise alone: the mean is 1, the variance
    that of the noise (1 / looks for speckle), and the ratio shows no structure (Gomez, Ospina and
    Frery 2017).  Structure is measured as the correlation of pixels `_BEYOND_GRAIN` apart along
    rows and columns, the mean of both, because the grain of real sonars is some pixels wide.
    NaN where nothing is bright enough.
    """
    below = denoised.astype(np.float64)
    lit = below >= _DARK
    if region is not None:
        lit = lit & region
    if not lit.any():
        return dict.fromkeys(("ratio_mean", "ratio_variance", "ratio_correlation"), math.nan)
    ratio = np.divide(noisy, below, out=np.ones_like(below), where=lit)
    along_rows = _correlation(ratio[:, _BEYOND_GRAIN:], ratio[:, :-_BEYOND_GRAIN],
                              lit[:, _BEYOND_GRAIN:] & lit[:, :-_BEYOND_GRAIN])  # fmt: skip
    along_columns = _correlation(ratio[_BEYOND_GRAIN:], ratio[:-_BEYOND_GRAIN],
                                 lit[_BEYOND_GRAIN:] & lit[:-_BEYOND_GRAIN])  # fmt: skip
    return {
        "ratio_mean": float(ratio[lit].mean()),
        "ratio_variance": float(ratio[lit].var()),
        "ratio_correlation": (along_rows + along_columns) / 2,
    }


def _correlation(values: Float64s, others: Float64s, mask: Bools) -> float:
    """Pearson's; NaN where nothing varies."""
    first = values[mask] - values[mask].mean() if mask.any() else np.zeros(0)
    second = others[mask] - others[mask].mean() if mask.any() else np.zeros(0)
    power = float((first @ first) * (second @ second))
    return float(first @ second) / math.sqrt(power) if power > _NO_POWER else math.nan
