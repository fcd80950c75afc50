"""One pair of pictures in memory, and the part of it that the sonar sees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Gray = npt.NDArray[np.float32]

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Picture:
    """noisy, clean: (H, W) float32 in 0..1; shadow, sector: (H, W) bool.

    has_shadow: whether the true shadow is known; without it `shadow` is all false.
    """

    noisy: Gray
    clean: Gray
    shadow: Mask
    sector: Mask
    has_shadow: bool = True


def sector_of(noisy: npt.NDArray[Any], clean: npt.NDArray[Any], shadow: Mask) -> Mask:
    """(H, W) bool: the pixels where the sonar could have measured anything.

    The shadow mask is confined to the sector, and every other pixel of it carries an echo.
    """
    return np.asarray(shadow | (clean > 0) | (noisy > 0))
