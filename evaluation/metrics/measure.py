"""The quality of one image against the clean one."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from ..data.picture import sector_of
from . import fidelity as metrics
from .checks import checked_pair
from .reference import Compared, Reference


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
