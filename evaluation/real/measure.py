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
from ..methods import Method
from ..metrics.fidelity import decibels, edge_preservation, finite_psnr, psnr, ssim
from ..metrics.measure import Figures, fit_levels
from ..metrics.speckle import (
    SIDE,
    contrast_to_noise,
    enl,
    homogeneous_zones,
    m_index,
    mean_ratio,
    ratio_image,
    zone_enl,
)
from ..runner import MethodFailed, Subject
from .groups import Judged

if TYPE_CHECKING:
    from ...factory.sonar.geometry import FanGeometry

Mask = npt.NDArray[np.bool_]

UNCHANGED = 0.5 / 255
"""A picture that differs nowhere by more is the same in 8 bits."""

_CALM = 15  # of the median that decides what is dark, pixels
_DARKEST, _BRIGHTER = 0.1, 0.5  # shares of the sector
_RING = 15  # around an object, pixels


def score(picture: Gray, reference: Gray, where: Mask) -> tuple[float, float]:
    """PSNR in dB and SSIM of a picture against its reference, after one gain and offset."""
    fitted = fit_levels([(picture[where], reference[where])])(picture)
    return (
        finite_psnr(psnr(reference, fitted, data_range=1.0, mask=where)),
        ssim(reference, fitted, data_range=1.0, mask=where),
    )


def psnr_of(picture: Gray, reference: Gray, where: Mask) -> float:
    """The PSNR of `score` alone, dB; several times as fast."""
    near, far = picture[where], reference[where]
    fitted = fit_levels([(near, far)])(near)
    squared = float(np.mean(np.square(fitted - far, dtype=np.float64)))
    return finite_psnr(decibels(squared, 1.0))


@dataclass(frozen=True)
class Scene:
    """What all methods share on a picture; all chosen on the picture as it is.

    sector, dark, bright: (H, W) bool.  zones: (N, 2) corners of even blocks.
    objects, around: (H, W) bool, of the mask; None without.
    """

    noisy: Gray
    sector: Mask
    dark: Mask
    bright: Mask
    zones: npt.NDArray[np.int64]
    objects: Mask | None
    around: Mask | None


def scene_of(noisy: Gray, sector: Mask, classes: npt.NDArray[np.uint8] | None, name: str) -> Scene:
    """What is measured on a picture, (H, W) in 0..1.

    sector: (H, W) bool.  classes: (H, W) class indices, 0 = background.
    Raises FactoryError, which names it, when it is too small or black.
    """
    if min(noisy.shape) < SIDE or not sector.any() or not noisy[sector].any():
        raise FactoryError(f"{name}: black, or smaller than {SIDE} pixels; take it out")
    calm = cv2.medianBlur(np.rint(np.clip(noisy, 0, 1) * 255).astype(np.uint8), _CALM)
    # Near the edge of the sector the median sees black that is no shadow.
    inner = cv2.erode(sector.astype(np.uint8), np.ones((_CALM, _CALM), np.uint8)).astype(bool)
    inner = inner if inner.any() else sector
    low, high = np.quantile(calm[inner], (_DARKEST, _BRIGHTER))
    objects = around = None
    if classes is not None:
        objects = classes > 0
        wide = cv2.dilate(objects.astype(np.uint8), np.ones((2 * _RING + 1,) * 2, np.uint8))
        around = wide.astype(bool) & ~objects & sector
    return Scene(
        noisy,
        sector,
        inner & (calm <= low),
        inner & (calm > max(low, high)),
        homogeneous_zones(noisy, data_range=1.0, sector=sector),
        objects,
        around,
    )


def figures_of(image: Gray, shared: Scene) -> Figures:
    """The figures without a truth of (H, W) in 0..1; NaN where one does not exist."""
    dark, bright = (float(np.mean(image[part])) for part in (shared.dark, shared.bright))
    ratio = ratio_image(shared.noisy, image)
    found = {
        "enl": enl(image, shared.zones),
        "cnr": contrast_to_noise(image, shared.bright, shared.dark),
        "shadow_level": dark / bright if bright > 0 else float("nan"),
        "edges_kept": edge_preservation(shared.noisy, image, data_range=1.0, mask=shared.sector),
        "ratio_mean": mean_ratio(ratio),
        "m_index": m_index(ratio, zone_enl(shared.noisy, shared.zones), shared.zones),
    }
    if shared.objects is not None and shared.around is not None:
        found["object_cnr"] = contrast_to_noise(image, shared.objects, shared.around)
    return found


@dataclass(frozen=True, eq=False)
class RealPicture(Subject):
    """A judged picture."""

    judged: Judged

    def seen(self, method: Method) -> Gray:
        """See `Subject`."""
        if method.looks:
            raise MethodFailed("needs several looks at a scene that stands still")
        return self.judged.noisy

    def geometry(self) -> FanGeometry | None:
        """See `Subject`."""
        return self.judged.geometry

    def given(self, method: Method) -> Gray | None:
        """The mean or median of several frames; None where too few frames are left to judge it."""
        several = self.judged.several
        return None if several is None else getattr(several, method.given)

    def measure(self, image: Gray, method: Method) -> Figures:
        """Nearness to the reference after one gain and offset, and the figures without a truth.

        What is made of several frames is judged by the others alone.
        """
        judged = self.judged
        figures: Figures = {"unchanged": float(np.abs(image - judged.noisy).max() < UNCHANGED)}
        reference = (
            judged.several.reference if method.given and judged.several else judged.reference
        )
        if reference is not None:
            psnr_db, similarity = score(image, reference, judged.where)
            before = self._before_several if method.given else self._before
            figures |= {
                "psnr_db": psnr_db,
                "ssim": similarity,
                "gain_db": psnr_db - before[0],
                "gain_ssim": similarity - before[1],
            }
        return figures | figures_of(image, self._scene)

    @cached_property
    def _scene(self) -> Scene:
        shot = self.judged.shot
        classes = None if shot.mask is None else shot.classes()
        return scene_of(self.judged.noisy, self.judged.where, classes, str(shot.path))

    @cached_property
    def _before(self) -> tuple[float, float]:
        """How near the picture is to its reference as it is."""
        assert self.judged.reference is not None
        return score(self.judged.noisy, self.judged.reference, self.judged.where)

    @cached_property
    def _before_several(self) -> tuple[float, float]:
        assert self.judged.several is not None
        return score(self.judged.noisy, self.judged.several.reference, self.judged.where)
