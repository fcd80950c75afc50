"""The metrics beyond PSNR, SSIM and GMSD, for one denoised picture."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from evaluation.baselines.base import Gray
from evaluation.checks import MetricError
from evaluation.edges import edge_preservation
from evaluation.metrics import deviation
from evaluation.multiscale import SMALLEST, ms_ssim_of
from evaluation.pictures import Picture
from evaluation.reference import Reference
from evaluation.speckle import contrast_to_noise, enl, homogeneous_zones, m_index, ratio_mean


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


def zones_of(pair: Picture) -> npt.NDArray[np.int64]:
    """The even zones of a pair's clean picture; none where it is smaller than one."""
    try:
        return homogeneous_zones(pair.clean, data_range=1.0, sector=pair.sector)
    except MetricError:
        return np.empty((0, 2), dtype=np.int64)


def texture_of(
    denoised: Gray,
    pair: Picture,
    reference: Reference | None = None,
    zones: npt.NDArray[np.int64] | None = None,
) -> Texture:
    """All of them; denoised: (H, W) float32 in 0..1.

    reference: of pair.clean, and zones: `zones_of(pair)`, if at hand.
    """
    clean, noisy, sector = pair.clean, pair.noisy, pair.sector
    zones = zones_of(pair) if zones is None else zones
    big = min(clean.shape) >= SMALLEST
    reference = reference or Reference(clean.astype(np.float64), 1.0)
    image = denoised.astype(np.float64)
    return Texture(
        gmsd_unpooled=deviation(reference.gms_map(image, pooled=False)),
        ms_ssim=ms_ssim_of(reference, image) if big else math.nan,
        edge_preservation=edge_preservation(clean, denoised, data_range=1.0, mask=sector),
        enl=enl(denoised, zones),
        cnr=contrast_to_noise(denoised, sector & ~pair.shadow & (clean > 0), pair.shadow),
        ratio_mean=ratio_mean(noisy, denoised, data_range=1.0),
        m_index=m_index(noisy, denoised, zones, data_range=1.0),
    )
