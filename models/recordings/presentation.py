"""Pictures as networks know them: far range on top, echoes bright, and bright enough.

Samples of 12 bits in files of 16, and amplitudes without a logarithm, fill a small part of the grey
scale.  Networks take what is that dark for shadow, or for another kind of noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...factory.sonar.geometry import FanGeometry
from .fan.finder import border

Grey = npt.NDArray[np.float32]

_SHARE = 99.5  # percentile of the pixels that are not zero
_DARK, _DARKER, _WANTED = 0.25, 0.125, 0.5
"""Bright pixels below the first make a picture dark; below the second they come to the last."""
_WHITE = 0.5
"""A page around a fan, and the median within it, above which echoes are dark on white."""


@dataclass(frozen=True)
class Presentation:
    """What is done to a picture before networks see it, and undone after.

    quarter_turns: counter-clockwise.  negative: echoes are dark on white.  gain: what the picture
    is multiplied by.  geometry: of the picture that networks see; None where it is not known.
    """

    quarter_turns: int
    negative: bool
    gain: np.float32
    geometry: FanGeometry | None

    def shown(self, grey: Grey) -> Grey:
        """A picture, (H, W) in 0..1, as networks see it; those beside it in time are alike."""
        if self.quarter_turns:
            grey = np.ascontiguousarray(np.rot90(grey, self.quarter_turns))
        if self.negative:
            grey = 1 - grey
        return grey if self.gain == 1 else np.minimum(grey * self.gain, 1)

    def undone(self, grey: Grey) -> Grey:
        """The inverse of `shown`."""
        if self.gain != 1:
            grey = grey / self.gain
        if self.negative:
            grey = 1 - grey
        if self.quarter_turns:
            grey = np.ascontiguousarray(np.rot90(grey, -self.quarter_turns))
        return grey


def presentation_of(grey: Grey, geometry: FanGeometry | None) -> Presentation:
    """How a picture, (H, W) in 0..1, is to be shown; most are left as they are."""
    turns, negative = 0, False
    if geometry is not None:
        turns = geometry.quarter_turns
        negative = is_negative(grey, geometry)
        geometry = geometry.turned(*grey.shape) if turns else geometry
    return Presentation(turns, negative, gain_of(1 - grey if negative else grey), geometry)


def is_negative(grey: Grey, geometry: FanGeometry) -> bool:
    """Whether echoes are dark on white, and so is the page around the fan."""
    if geometry.layout == "polar" or np.median(border(grey)) <= _WHITE:
        return False
    inside = geometry.maps(0, 0, *grey.shape)["sector"] > 0
    if inside.all() or not inside.any() or grey[~inside].mean() <= _WHITE:
        return False
    return bool(np.median(grey[inside]) > _WHITE)


def gain_of(grey: Grey) -> np.float32:
    """By what a picture, (H, W) in 0..1, is to be multiplied; 1 where it is bright enough.

    It rises without a step as pictures get darker, and no pixel comes above 1.
    """
    # Most pictures are bright enough, and counting takes a fiftieth of what a percentile does.
    few = np.count_nonzero(grey) * (1 - _SHARE / 100)
    if np.count_nonzero(grey >= _DARK) >= few:
        return np.float32(1)
    lit = grey[grey > 0]
    bright = max(float(np.percentile(lit, _SHARE)), 1e-6)
    gain = _WANTED / bright if bright < _DARKER else (_DARK / bright) ** 2
    return np.float32(max(1.0, min(gain, 1 / float(lit.max()))))
