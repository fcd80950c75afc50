"""What is measured of a denoised picture; simulated and real ones alike where they can be."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ..data.picture import Picture, sector_of
from ..metrics.checks import MetricError, checked_pair
from ..metrics.edges import edge_preservation
from ..metrics.fidelity import SSIM_SMALLEST, finite_psnr
from ..metrics.measure import score_pair
from ..metrics.reference import Compared, Reference
from ..metrics.speckle import enl, homogeneous_zones, m_index
from ..real.score import score
from ..report.names import Metric
from .folder import Entry, PictureSet
from .pictures import Gray8, in_unit_range

Gray = npt.NDArray[np.float32]
Figures = dict[str, float]

METRICS = {
    "psnr": Metric("PSNR, dB", 2, 1),
    "psnr_levels": Metric("PSNR after levels, dB", 2, 1),
    "ssim": Metric("SSIM", 3, 1),
    "gmsd": Metric("GMSD", 3, -1),
    "shadow_iou": Metric("shadow IoU", 3, 1),
    "edges": Metric("edges", 3, 1),
    "enl": Metric("ENL", 1, 0),
    "m_index": Metric("M-index", 2, 0),
}
"""In the order of the tables."""

RANKED = {"simulated": "psnr", "real": "psnr_levels"}
"""Kind of a set -> the figure that its table is sorted by and tested in."""

_SHADOW_THRESHOLD = 0.02


def measure(pictures: PictureSet, one: Entry, image: Gray8) -> Figures:
    """The figures of a denoised picture (H, W); NaN where one does not exist.

    Raises FactoryError for a damaged reference.
    """
    noisy, grey = in_unit_range(pictures.noisy(one)), in_unit_range(image)
    clean, mask = pictures.clean(one), pictures.mask(one)
    try:
        if pictures.entry.kind == "real":
            return _real(grey, noisy, clean, mask)
        return _simulated(grey, noisy, clean, mask)
    except MetricError as error:
        raise FactoryError(f"{pictures.name}/{one.name}.png: {error}") from error


def _simulated(image: Gray, noisy: Gray, clean: Gray, shadow: npt.NDArray[np.bool_]) -> Figures:
    pair = Picture(noisy, clean, shadow, sector_of(noisy, clean, shadow))
    truth, checked = checked_pair(clean, image, 1.0, smallest=SSIM_SMALLEST)
    quality = score_pair(
        image,
        clean,
        shadow,
        data_range=1.0,
        shadow_threshold=_SHADOW_THRESHOLD,
        sector=pair.sector,
        compared=Compared(Reference(truth, 1.0), checked),
    )
    return {
        "psnr": finite_psnr(quality.psnr),
        "psnr_levels": score(image, clean, pair.sector).psnr_db,
        "ssim": quality.ssim,
        "gmsd": quality.gmsd,
        "shadow_iou": quality.shadow_iou if shadow.any() else math.nan,
        **_texture(image, noisy, clean, pair.sector),
    }


def _real(image: Gray, noisy: Gray, mean: Gray, where: npt.NDArray[np.bool_]) -> Figures:
    near = score(image, mean, where)
    return {
        "psnr_levels": near.psnr_db,
        "ssim": near.ssim,
        **_texture(image, noisy, mean, where),
    }


def _texture(image: Gray, noisy: Gray, clean: Gray, where: npt.NDArray[np.bool_]) -> Figures:
    # Chosen on the reference, so they are the same for all methods.
    zones = homogeneous_zones(clean, data_range=1.0, sector=where)
    return {
        "edges": edge_preservation(clean, image, data_range=1.0, mask=where),
        "enl": enl(image, zones),
        "m_index": m_index(noisy, image, zones, data_range=1.0),
    }
