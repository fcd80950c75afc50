"""The metrics beyond PSNR, SSIM and GMSD, for one denoised picture."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
import numpy.typing as npt

from ..data.picture import Picture
from .checks import MetricError
from .edges import Edges
from .fidelity import deviation
from .multiscale import SMALLEST, ms_ssim_of
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

    def texture(self, compared: Compared) -> Texture:
        """All of them, of an image beside `reference`; MetricError where it cannot be measured."""
        image = compared.image
        ratio = ratio_of(self._noisy, image, 1.0)
        return Texture(
            gmsd_unpooled=deviation(self.reference.gms_map(image, pooled=False)),
            ms_ssim=ms_ssim_of(compared) if min(image.shape) >= SMALLEST else math.nan,
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
