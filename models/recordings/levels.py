"""From the numbers of an array to grey values, and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.errors import FrameError
from .base import FULL_SCALE, Samples


@dataclass(frozen=True)
class Levels:
    """Which numbers show as black and as white, such as -60 and 0 dB."""

    black: float
    white: float

    def shown(self, page: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """Float32 in 0..1; numbers beyond are black or white, and NaN is black."""
        shown = (page.astype(np.float64) - self.black) / (self.white - self.black)
        return np.clip(np.nan_to_num(shown, nan=0.0), 0, 1).astype(np.float32)

    def stored(self, shown: npt.NDArray[Any], before: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Grey values as numbers of `before`'s dtype; what was beyond the levels there stays."""
        values = self.black + shown.astype(np.float64) * (self.white - self.black)
        low, high = sorted((self.black, self.white))
        within = (before >= low) & (before <= high)
        values = np.rint(values) if before.dtype.kind in "ui" else values
        found = before.copy()
        found[within] = values[within].astype(before.dtype)
        return found


def as_samples(page: npt.NDArray[Any], what: str) -> Samples:
    """A page whose numbers are grey values as they are: uint8, uint16, or floats as float32.

    what: names it in errors.  Raises FrameError for other dtypes, NaN and floats outside 0..1.
    """
    if page.dtype.kind == "f":
        with np.errstate(over="ignore"):  # infinite: outside 0..1
            page = page.astype(np.float32)
    if str(page.dtype) not in FULL_SCALE:
        raise FrameError(
            f"{what}: pixels are {page.dtype}; expected {', '.join(FULL_SCALE)}, or give --levels"
        )
    if page.dtype == np.float32 and np.isnan(page).any():
        raise FrameError(f"{what}: holds NaN; set what was not measured to 0, or give --levels")
    if page.dtype == np.float32 and not (page.min() >= 0 and page.max() <= 1):
        raise FrameError(
            f"{what}: floats must be grey values from 0 to 1, these are {page.min():g} to "
            f"{page.max():g}; scale them or denoise with --levels BLACK WHITE (echoes in linear "
            "units: their logarithm)"
        )
    return page


def swapped(picture: npt.NDArray[Any]) -> Samples:
    """Colours in OpenCV's order (BGR), or the other way round; numbers as the machine orders them.

    picture: (H, W) or (H, W, C); what is beside three colours stays where it is.
    """
    if picture.ndim == 3 and picture.shape[2] >= 3:
        picture = np.concatenate([picture[..., 2::-1], picture[..., 3:]], axis=2)
    return picture.astype(picture.dtype.newbyteorder("="), copy=False)
