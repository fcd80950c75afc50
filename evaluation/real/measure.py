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
from ..methods.method import Method
from ..metrics.edges import edge_preservation
from ..metrics.measure import Figures
from ..metrics.speckle import contrast_to_noise, enl, homogeneous_zones, m_index, ratio_mean
from ..runner import MethodFailed
from .groups import Judged
from .score import Score, score

if TYPE_CHECKING:
    from ...factory.sonar.geometry import FanGeometry

Mask = npt.NDArray[np.bool_]

UNCHANGED = 0.5 / 255
"""A picture that differs nowhere by more is the same in 8 bits."""
MEAN, MEDIAN = "mean", "median"
"""What is given of several frames, without any method."""

_SIDE = 16  # of an even zone, pixels
_CALM = 15  # of the median that decides what is dark, pixels
_DARKEST, _BRIGHTER = 0.1, 0.5  # shares of the sector
_RING = 15  # around an object, pixels


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
    if min(noisy.shape) < _SIDE or not sector.any() or not noisy[sector].any():
        raise FactoryError(f"{name}: black, or smaller than {_SIDE} pixels; take it out")
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
        homogeneous_zones(noisy, data_range=1.0, sector=sector, side=_SIDE),
        objects,
        around,
    )


def figures_of(image: Gray, shared: Scene) -> Figures:
    """The figures without a truth of (H, W) in 0..1; NaN where one does not exist."""
    dark, bright = (float(np.mean(image[part])) for part in (shared.dark, shared.bright))
    found = {
        "enl": enl(image, shared.zones, side=_SIDE),
        "cnr": contrast_to_noise(image, shared.bright, shared.dark),
        "shadow_level": dark / bright if bright > 0 else float("nan"),
        "edges_kept": edge_preservation(shared.noisy, image, data_range=1.0, mask=shared.sector),
        "ratio_mean": ratio_mean(shared.noisy, image, data_range=1.0),
        "m_index": m_index(shared.noisy, image, shared.zones, data_range=1.0, side=_SIDE),
    }
    if shared.objects is not None and shared.around is not None:
        found["object_cnr"] = contrast_to_noise(image, shared.objects, shared.around)
    return found


@dataclass(frozen=True, eq=False)
class RealPicture:
    """A judged picture; a `simnfnd.evaluation.runner.Subject`."""

    judged: Judged

    def key(self, method: Method) -> str:
        """See `Subject`; nothing of real pictures is stored."""
        return self.judged.shot.name

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
        reference, before = judged.reference, self._before
        if method.given:
            assert judged.several is not None
            reference, before = judged.several.reference, self._before_several
        if reference is not None and before is not None:
            near = score(image, reference, judged.where)
            figures |= {
                "psnr_db": near.psnr_db,
                "ssim": near.ssim,
                "gain_db": near.psnr_db - before.psnr_db,
                "gain_ssim": near.ssim - before.ssim,
            }
        return figures | figures_of(image, self._scene)

    @cached_property
    def _scene(self) -> Scene:
        shot = self.judged.shot
        classes = None if shot.mask is None else shot.classes()
        return scene_of(self.judged.noisy, self.judged.where, classes, str(shot.path))

    @cached_property
    def _before(self) -> Score | None:
        """How near the picture is to its reference as it is."""
        judged = self.judged
        known = judged.reference is not None
        return score(judged.noisy, judged.reference, judged.where) if known else None  # type: ignore[arg-type]

    @cached_property
    def _before_several(self) -> Score:
        assert self.judged.several is not None
        return score(self.judged.noisy, self.judged.several.reference, self.judged.where)
