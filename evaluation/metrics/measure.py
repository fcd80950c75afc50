"""A pair in memory, and everything that is measured of an image beside its clean one."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from . import fidelity as metrics
from .speckle import SIDE, contrast_to_noise, enl, homogeneous_zones, mean_ratio

Gray = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Floats = npt.NDArray[np.floating]

Figures = dict[str, float]
"""Metric -> value; NaN where it does not exist.  `_fan`: inside the sonar's sector alone."""

_OF_SHADOW = ("shadow_iou", "shadow_residual", "false_light_rate")


@dataclass(frozen=True)
class Picture:
    """noisy, clean: (H, W) float32 in 0..1; shadow, sector: (H, W) bool.

    has_shadow: whether the true shadow is known; without it `shadow` is all false.
    """

    noisy: Gray
    clean: Gray
    shadow: Mask
    sector: Mask
    has_shadow: bool = True


def sector_of(noisy: npt.NDArray[Any], clean: npt.NDArray[Any], shadow: Mask) -> Mask:
    """(H, W) bool: the pixels where the sonar could have measured anything.

    The shadow mask is confined to the sector, and every other pixel of it carries an echo.
    """
    return np.asarray(shadow | (clean > 0) | (noisy > 0))


@dataclass(frozen=True)
class Levels:
    """One global gain and offset: out = gain * image + offset, clipped to 0..1."""

    gain: float
    offset: float

    def __call__(self, image: Floats) -> Gray:
        """The corrected picture, same shape, float32 in 0..1."""
        return np.clip(self.gain * image + self.offset, 0, 1).astype(np.float32)


def fit_levels(pairs: Iterable[tuple[Floats, Floats]]) -> Levels:
    """The least-squares gain and offset from (image, clean) pairs, over all pixels of all pairs.

    A constant image leaves only the offset, the mean of the clean ones.
    """
    sums = np.zeros(5)
    for image, clean in pairs:
        x, y = image.astype(np.float64).ravel(), clean.astype(np.float64).ravel()
        sums += np.array([x.size, x.sum(), y.sum(), x @ x, x @ y])
    mean_x, mean_y, mean_xx, mean_xy = sums[1:] / sums[0]
    variance = mean_xx - mean_x**2
    if variance < 1e-12:
        return Levels(0.0, float(mean_y))
    gain = (mean_xy - mean_x * mean_y) / variance
    return Levels(float(gain), float(mean_y - gain * mean_x))


class Scene:
    """A pair, checked, and what the metrics of all methods on it share."""

    def __init__(self, pair: Picture) -> None:
        """Raises MetricError for a pair without anything to measure."""
        if not pair.sector.any():
            raise metrics.MetricError("clean, noisy and shadow are empty; nothing to measure")
        self.pair = pair
        self.reference = metrics.Reference(pair.clean.astype(np.float64), 1.0)

    def figures(self, image: metrics.Image, *, shadow_threshold: float, texture: bool) -> Figures:
        """All metrics of an image (H, W) in 0..1, with `texture` those of texture and speckle, too.

        shadow_threshold: fraction of full scale.  Raises MetricError where it cannot be measured.
        """
        pair, reference = self.pair, self.reference
        _, values = metrics.checked_pair(pair.clean, image, 1.0, smallest=metrics.SSIM_SMALLEST)
        squared = np.square(reference.image - values)
        similarity, gradients = reference.ssim_map(values), reference.gms_map(values)
        found: Figures = {
            "psnr": metrics.decibels(float(squared.mean()), 1.0),
            "ssim": metrics.mean_ssim(similarity),
            "gmsd": metrics.deviation(gradients),
            "psnr_fan": metrics.decibels(float(squared[pair.sector].mean()), 1.0),
            "ssim_fan": metrics.mean_ssim(similarity, pair.sector),
            "gmsd_fan": metrics.deviation(gradients, pair.sector),
            "shadow_iou": metrics.shadow_iou(
                pair.shadow, image, threshold=shadow_threshold, sector=pair.sector
            ),
            "shadow_residual": metrics.shadow_residual(pair.shadow, image, data_range=1.0),
            "false_light_rate": metrics.false_light_rate(
                pair.shadow, image, threshold=shadow_threshold
            ),
        }
        if not pair.has_shadow:
            found.update(dict.fromkeys(_OF_SHADOW, math.nan))
        return found | (self._texture(values) if texture else {})

    def _texture(self, image: npt.NDArray[np.float64]) -> Figures:
        """NaN where a metric does not exist: too small a picture, no even zone, no shadow.

        The zones are chosen on the clean picture, so they are the same for all methods.
        """
        pair, reference = self.pair, self.reference
        large = min(image.shape) >= metrics.MS_SSIM_SMALLEST
        return {
            "gmsd_unpooled": metrics.deviation(reference.gms_map(image, pooled=False)),
            "ms_ssim": reference.ms_ssim(image) if large else math.nan,
            "edge_preservation": reference.edges_kept(image, pair.sector),
            "enl": enl(image, self._zones),
            "cnr": contrast_to_noise(
                image, pair.sector & ~pair.shadow & (pair.clean > 0), pair.shadow
            ),
            "ratio_mean": mean_ratio(pair.noisy, image),
        }

    @cached_property
    def _zones(self) -> npt.NDArray[np.int64]:
        """The even zones of the clean picture; none where it is smaller than one."""
        pair = self.pair
        if min(pair.clean.shape) < SIDE:
            return np.empty((0, 2), dtype=np.int64)
        return homogeneous_zones(pair.clean, data_range=1.0, sector=pair.sector)
