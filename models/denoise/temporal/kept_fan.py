"""A fan that stays where it was found: finding it anew in each frame costs more than the network.

It stays while what lies around it stays black (or whatever it was), and what lies along its edges
stays lit.  A frame without any fan is believed for a few more.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from ....factory.sonar.geometry import FanGeometry
from .motion import Grey, grey_of

_SIDE = 256  # pictures are compared about this large
_APART, _MOST_APART = 0.03, 0.01
"""Grey values that differ, and the part of the surroundings that may."""
_LEAST_AROUND = 0.01  # part of a picture around the fan, else nothing says that it stays
_RIM = np.ones((9, 9), np.uint8)
_STILL_LIT = 0.75  # of the rim that was lit when the fan was found
_WITHOUT = 7  # frames after one without a fan that are believed to have none


class KeptFan:
    """Where range and bearing were found in a frame, and whether they are there in another."""

    def __init__(self, geometry: FanGeometry | None, levels: Grey) -> None:
        """levels: (H, W) or (H, W, C) in 0..1, the frame in which `geometry` was found."""
        self.geometry = geometry
        self._shape, self._left = levels.shape, _WITHOUT
        if geometry is None:
            return
        inside = geometry.sector_mask(*levels.shape[:2]).astype(np.float32)
        small = _small(inside)
        sector = (small > 0).astype(np.uint8)
        self._seen = _small(grey_of(levels))
        self._around = cv2.dilate(sector, _RIM) == 0
        self._rim: npt.NDArray[np.bool_] = (small > 0.99) & (cv2.erode(sector, _RIM) == 0)
        ground = self._seen[self._around]
        self._level = (float(np.median(ground)) if ground.size else 0.0) + _APART
        self._lit = float((self._seen[self._rim] > self._level).mean()) if self._rim.any() else 0.0
        self._tells = bool(self._around.mean() >= _LEAST_AROUND) and self._lit > 0

    def stays(self, levels: Grey) -> bool:
        """Whether the geometry is that of another frame of the recording, too."""
        if levels.shape != self._shape:
            return False
        if self.geometry is None:
            self._left -= 1
            return self._left >= 0
        if not self._tells:
            return False
        now = _small(grey_of(levels))
        apart = np.abs(now - self._seen)[self._around] > _APART
        lit = float((now[self._rim] > self._level).mean())
        return bool(apart.mean() <= _MOST_APART) and lit >= _STILL_LIT * self._lit


def _small(plane: Grey) -> Grey:
    scale = max(1, max(plane.shape) // _SIDE)
    size = -(-plane.shape[1] // scale), -(-plane.shape[0] // scale)
    return cv2.resize(plane, size, interpolation=cv2.INTER_AREA)
