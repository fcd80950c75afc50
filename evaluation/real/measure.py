"""What is measured on a real picture: nearness to its reference, and figures without a truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ..filters.base import Gray
from ..metrics.fidelity import edge_preservation, finite_psnr, psnr, ssim
from ..metrics.measure import Figures, fit_levels
from ..metrics.speckle import SIDE, contrast_to_noise, enl, homogeneous_zones, mean_ratio
from ..runner import Subject
from .groups import Judged

if TYPE_CHECKING:
    from ...factory.sonar.geometry import FanGeometry

Mask = npt.NDArray[np.bool_]

_CALM = 15  # of the median that decides what is dark, pixels
_DARKEST, _BRIGHTER = 0.1, 0.5  # shares of the sector


def score(picture: Gray, reference: Gray, where: Mask) -> tuple[float, float]:
    """PSNR in dB and SSIM of a picture against its reference, after one gain and offset."""
    fitted = fit_levels([(picture[where], reference[where])])(picture)
    return (
        finite_psnr(psnr(reference, fitted, data_range=1.0, mask=where)),
        ssim(reference, fitted, data_range=1.0, mask=where),
    )


@dataclass(frozen=True)
class Scene:
    """What all methods share on a picture; all chosen on the picture as it is.

    sector, dark, bright: (H, W) bool.  zones: (N, 2) corners of even blocks.
    """

    noisy: Gray
    sector: Mask
    dark: Mask
    bright: Mask
    zones: npt.NDArray[np.int64]


def scene_of(noisy: Gray, sector: Mask, name: str) -> Scene:
    """What is measured on a picture, (H, W) in 0..1; sector: (H, W) bool.

    Raises FactoryError, which names it, when it is too small or black.
    """
    if min(noisy.shape) < SIDE or not sector.any() or not noisy[sector].any():
        raise FactoryError(f"{name}: black, or smaller than {SIDE} pixels; take it out")
    calm = cv2.medianBlur(np.rint(np.clip(noisy, 0, 1) * 255).astype(np.uint8), _CALM)
    # Near the edge of the sector the median sees black that is no shadow.
    inner = cv2.erode(sector.astype(np.uint8), np.ones((_CALM, _CALM), np.uint8)).astype(bool)
    inner = inner if inner.any() else sector
    low, high = np.quantile(calm[inner], (_DARKEST, _BRIGHTER))
    dark, bright = inner & (calm <= low), inner & (calm > max(low, high))
    return Scene(
        noisy, sector, dark, bright, homogeneous_zones(noisy, data_range=1.0, sector=sector)
    )


def figures_of(image: Gray, shared: Scene) -> Figures:
    """The figures without a truth of (H, W) in 0..1; NaN where one does not exist."""
    dark, bright = (float(np.mean(image[part])) for part in (shared.dark, shared.bright))
    return {
        "enl": enl(image, shared.zones),
        "cnr": contrast_to_noise(image, shared.bright, shared.dark),
        "shadow_level": dark / bright if bright > 0 else float("nan"),
        "edges_kept": edge_preservation(shared.noisy, image, data_range=1.0, mask=shared.sector),
        "ratio_mean": mean_ratio(shared.noisy, image),
    }


@dataclass(frozen=True, eq=False)
class RealPicture(Subject):
    """A judged picture."""

    judged: Judged

    def seen(self) -> Gray:
        """See `Subject`."""
        return self.judged.noisy

    def geometry(self) -> FanGeometry | None:
        """See `Subject`."""
        return self.judged.geometry

    def measure(self, image: Gray) -> Figures:
        """Nearness to the reference after one gain and offset, and the figures without a truth."""
        judged = self.judged
        figures = figures_of(image, self._scene)
        if judged.reference is None:
            return figures
        psnr_db, similarity = score(image, judged.reference, judged.where)
        near = {"psnr_db": psnr_db, "ssim": similarity, "gain_db": psnr_db - self._before_db}
        return near | figures

    @cached_property
    def _scene(self) -> Scene:
        return scene_of(self.judged.noisy, self.judged.where, str(self.judged.shot.path))

    @cached_property
    def _before_db(self) -> float:
        """PSNR of the picture as it is."""
        assert self.judged.reference is not None
        return score(self.judged.noisy, self.judged.reference, self.judged.where)[0]
