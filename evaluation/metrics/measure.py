"""Everything that is measured of one image beside its clean one."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields
from functools import cached_property

import numpy as np
import numpy.typing as npt

from . import fidelity as metrics
from .checks import MetricError, checked_pair
from .edges import Edges
from .picture import Picture, sector_of
from .reference import Compared, Reference
from .speckle import (
    contrast_to_noise,
    enl,
    homogeneous_zones,
    m_index_of,
    mean_ratio,
    ratio_of,
    zone_enl,
)

Figures = dict[str, float]
"""Metric -> value; NaN where it does not exist."""


@dataclass(frozen=True)
class Quality:
    """What one pair measures; `_fan` = inside the sonar's sector alone (see `sector_of`)."""

    psnr: float
    ssim: float
    gmsd: float
    psnr_fan: float
    ssim_fan: float
    gmsd_fan: float
    shadow_iou: float
    shadow_residual: float
    false_light_rate: float


METRICS = tuple(item.name for item in fields(Quality))


@dataclass(frozen=True)
class Texture:
    """NaN where a metric does not exist: too small a picture, no even zone, no shadow.

    The zones are chosen on the clean picture, so they are the same for all methods.
    """

    gmsd_unpooled: float
    ms_ssim: float
    edge_preservation: float
    enl: float
    cnr: float
    ratio_mean: float
    m_index: float


TEXTURE = tuple(item.name for item in fields(Texture))
_OF_SHADOW = ("shadow_iou", "shadow_residual", "false_light_rate")


def score_pair(
    noisy: metrics.Image,
    clean: metrics.Image,
    shadow: metrics.Mask,
    *,
    data_range: float,
    shadow_threshold: float,
    sector: metrics.Mask | None = None,
    compared: Compared | None = None,
) -> Quality:
    """The quality of one noisy image; raises MetricError when there is nothing to compare.

    noisy, clean: (H, W) of one dtype.  shadow: (H, W) bool.  shadow_threshold: fraction of range.
    sector: where the sonar measures; needed for a denoised image, which may bleed out of it.
    compared: `noisy` beside `clean`, checked by the caller, where more is measured of the two.
    """
    if sector is None:
        sector = sector_of(noisy, clean, shadow)
    if not sector.any():
        raise metrics.MetricError("clean, noisy and shadow are empty; nothing to measure")
    if compared is None:
        a, b = checked_pair(clean, noisy, data_range, smallest=metrics.SSIM_SMALLEST)
        compared = Compared(Reference(a, data_range), b)
    squared = np.square(compared.reference.image - compared.image)
    similarity = compared.ssim_map
    gradients = compared.reference.gms_map(compared.image, pooled=True)
    threshold = shadow_threshold * data_range
    return Quality(
        psnr=metrics.decibels(float(squared.mean()), data_range),
        ssim=metrics.mean_ssim(similarity),
        gmsd=metrics.deviation(gradients),
        psnr_fan=metrics.decibels(float(squared[sector].mean()), data_range),
        ssim_fan=metrics.mean_ssim(similarity, sector),
        gmsd_fan=metrics.deviation(gradients, sector),
        shadow_iou=metrics.shadow_iou(shadow, noisy, threshold=threshold, sector=sector),
        shadow_residual=metrics.shadow_residual(shadow, noisy, data_range=data_range),
        false_light_rate=metrics.false_light_rate(shadow, noisy, threshold=threshold),
    )


class Scene:
    """A pair, checked, and what the metrics of all methods on it share."""

    def __init__(self, pair: Picture) -> None:
        self.pair = pair
        self.reference = Reference(pair.clean.astype(np.float64), 1.0)
        self._noisy = pair.noisy.astype(np.float64)

    @cached_property
    def zones(self) -> npt.NDArray[np.int64]:
        """The even zones of the clean picture; none where it is smaller than one."""
        try:
            return homogeneous_zones(self.pair.clean, data_range=1.0, sector=self.pair.sector)
        except MetricError:
            return np.empty((0, 2), dtype=np.int64)

    def figures(self, image: metrics.Image, *, shadow_threshold: float, texture: bool) -> Figures:
        """All metrics of an image (H, W) in 0..1; with `texture` those of `Texture`, too.

        Raises MetricError where it cannot be measured.
        """
        pair = self.pair
        _, checked = checked_pair(pair.clean, image, 1.0, smallest=metrics.SSIM_SMALLEST)
        compared = Compared(self.reference, checked)
        quality = score_pair(
            image,
            pair.clean,
            pair.shadow,
            data_range=1.0,
            shadow_threshold=shadow_threshold,
            sector=pair.sector,
            compared=compared,
        )
        found: Figures = {**asdict(quality), **(asdict(self.texture(compared)) if texture else {})}
        if not pair.has_shadow:
            found.update(dict.fromkeys(_OF_SHADOW, math.nan))
        return found

    def texture(self, compared: Compared) -> Texture:
        """All of them, of an image beside `reference`; MetricError where it cannot be measured."""
        image = compared.image
        ratio = ratio_of(self._noisy, image, 1.0)
        return Texture(
            gmsd_unpooled=metrics.deviation(self.reference.gms_map(image, pooled=False)),
            ms_ssim=metrics.ms_ssim_of(compared)
            if min(image.shape) >= metrics.MS_SSIM_SMALLEST
            else math.nan,
            edge_preservation=self._edges.kept(image),
            enl=enl(image, self.zones),
            cnr=contrast_to_noise(image, self._lit, self.pair.shadow),
            ratio_mean=mean_ratio(ratio),
            m_index=m_index_of(ratio, self._noisy_looks, self.zones),
        )

    @cached_property
    def _edges(self) -> Edges:
        return Edges(self.reference.image, 1.0, self.pair.sector)

    @cached_property
    def _lit(self) -> npt.NDArray[np.bool_]:
        return self.pair.sector & ~self.pair.shadow & (self.pair.clean > 0)

    @cached_property
    def _noisy_looks(self) -> npt.NDArray[np.float64]:
        return zone_enl(self._noisy, self.zones)
