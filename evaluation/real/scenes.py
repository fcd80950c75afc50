"""What is measured on a picture: its sector, even zones, dark and bright ground, objects."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ..filters.base import Gray
from ..metrics.speckle import homogeneous_zones

Mask = npt.NDArray[np.bool_]

SIDE = 16  # of an even zone, pixels
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
        homogeneous_zones(noisy, data_range=1.0, sector=sector, side=SIDE),
        objects,
        around,
    )
