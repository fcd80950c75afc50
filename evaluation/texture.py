"""The metrics beyond PSNR, SSIM and GMSD, for one denoised picture."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from evaluation.baselines.base import Gray
from evaluation.checks import MetricError
from evaluation.edges import edge_preservation
from evaluation.multiscale import SMALLEST, ms_ssim
from evaluation.pictures import Picture
from evaluation.speckle import contrast_to_noise, enl, homogeneous_zones, m_index, ratio_mean


@dataclass(frozen=True)
class Texture:
    """NaN where a metric does not exist: too small a picture, no even zone, no shadow.

    The zones are chosen on the clean picture, so they are the same for all methods.
    """

    ms_ssim: float
    edge_preservation: float
    enl: float
    cnr: float
    ratio_mean: float
    m_index: float


TEXTURE = tuple(item.name for item in fields(Texture))


def texture_of(denoised: Gray, pair: Picture) -> Texture:
    """All of them; denoised: (H, W) float32 in 0..1."""
    clean, noisy, sector = pair.clean, pair.noisy, pair.sector
    try:
        zones = homogeneous_zones(clean, data_range=1.0, sector=sector)
    except MetricError:  # smaller than one zone
        zones = np.empty((0, 2), dtype=np.int64)
    big = min(clean.shape) >= SMALLEST
    return Texture(
        ms_ssim=ms_ssim(clean, denoised, data_range=1.0) if big else math.nan,
        edge_preservation=edge_preservation(clean, denoised, data_range=1.0, mask=sector),
        enl=enl(denoised, zones),
        cnr=contrast_to_noise(denoised, sector & ~pair.shadow & (clean > 0), pair.shadow),
        ratio_mean=ratio_mean(noisy, denoised, data_range=1.0),
        m_index=m_index(noisy, denoised, zones, data_range=1.0),
    )
