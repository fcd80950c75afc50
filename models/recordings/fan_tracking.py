"""The fan of each frame of a recording: searched where its outline changes, else kept.

An operator switches the range, a title comes before the first ping, a menu covers the fan for some
seconds.  To search each frame anew would cost more than the network and make the fan tremble, so
the outline that was found last is looked at first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.common.array_types import Array, Bools, Float64s, UInt8s
from ...factory.dataset.fan_geometry import FanGeometry
from .fan_finder import find_geometry
from .fans.confidence import light_ends, outline_pixels
from .fans.levels import grey_bytes

_KEPT_SHARE = 0.5  # of the outline that was seen when the fan was found
_LEAST_SPREAD = 6  # of 255: ringing of codecs on a flat ground
_MORE_OUTSIDE = 0.005  # part of the image: menus, or a scene that moved, where there was nothing
_LEAST_INSIDE = 0.2  # of what was lit in the fan when it was found
_THUMBNAIL_PX = 16
_LEAST_CUT = 1.0  # mean difference of thumbnails, of 255
RUNS = (64, 16, 4)
"""Images of a run whose first one is looked at."""
_OTHER_IMAGE = 0.5
"""Part of its brightness by which an image differs from one that was searched in vain, so that it
shows something else: the first ping after a title, after black frames or a dissolve."""


@dataclass
class _TrackedFan:
    """A fan with what its outline looked like.

    inner, outer: indices of pixels beside the outline, (3, pieces, samples).
    ground, spread: grey level around the fan, of 255.  shares: of each side that was seen.
    inside, outside: part of the image that is lit in the fan and around it.
    """

    geometry: FanGeometry
    inner: npt.NDArray[np.intp]
    outer: npt.NDArray[np.intp]
    sector: Bools
    ground: float
    spread: float
    shares: Float64s
    inside: float
    outside: float


class _Searched(NamedTuple):
    """An image whose fan is known.

    searched: number of the image that was searched.  fan: found there; None where it shows none.
    """

    number: int
    searched: int
    thumbnail: UInt8s
    fan: _TrackedFan | None

    def fits(self, grey: UInt8s, thumbnail: UInt8s) -> bool:
        """Whether another image shows the same fan, or as little of one."""
        if self.fan is not None:
            return _is_kept(self.fan, grey)
        apart = float(np.abs(thumbnail.astype(np.float64) - self.thumbnail).mean())
        brightness = max(float(thumbnail.mean()), float(self.thumbnail.mean()))
        return apart <= max(_LEAST_CUT, _OTHER_IMAGE * brightness)

    def explains(self, grey: UInt8s, number: int) -> bool:
        """Whether an image in which no fan is found shows this one, with parts in the dark."""
        is_recent = number - self.searched < 2 * RUNS[0]
        return self.fan is not None and is_recent and not _shows_other(self.fan, grey)


class FanTracker:
    """Finds the fan of each image of one size, in order.

    The first image of every run of 64 is searched.  Others keep its fan where they show its
    outline, else that of the first of their 16 or 4 images; an image that shows none of these is
    searched.  So a fan is a function of the last 128 images, wherever a recording begins.
    searched: how many images were searched.
    """

    def __init__(self) -> None:
        self.searched = 0
        self._next = 0
        self._runs: dict[int, tuple[int, _Searched]] = {}  # by length: number of the run
        self._last: _Searched | None = None

    def geometry(self, image: Array, number: int | None = None) -> FanGeometry | None:
        """The fan of the next image, (H, W) or (H, W, colours); None where it shows none.

        number: of the image in its recording; None: that after the last one.
        """
        number = self._next if number is None else number
        self._next = number + 1
        grey = grey_bytes(image)
        last = self._last
        if last is not None and number - last.number >= RUNS[0]:
            last = None
        if last is not None and last.fan is not None and _is_dark(last.fan, grey):
            return last.fan.geometry
        thumbnail = _thumbnail(grey)
        known = [
            self._runs[length][1]
            for length in RUNS
            if length in self._runs and self._runs[length][0] == number // length
        ]
        fitting = next((each for each in known if each.fits(grey, thumbnail)), None)
        if fitting is None:
            self.searched += 1
            geometry = find_geometry(image)
            fan = None if geometry is None else _fan_of(geometry, grey)
            fitting = _Searched(number, number, thumbnail, fan)
            if fan is None and last is not None and last.explains(grey, number):
                fitting = last
        self._last = fitting._replace(number=number)
        for length in RUNS:
            if self._runs.get(length, (-1,))[0] != number // length:
                self._runs[length] = number // length, fitting
        return None if fitting.fan is None else fitting.fan.geometry


def _fan_of(geometry: FanGeometry, grey: UInt8s) -> _TrackedFan:
    inner, outer = outline_pixels(geometry, *grey.shape)
    beside = grey.ravel()[outer[outer >= 0]].astype(np.float64)
    ground = float(np.median(beside)) if beside.size else 0.0
    spread = float(np.quantile(np.abs(beside - ground), 0.9)) if beside.size else 0.0
    sector = geometry.maps(0, 0, *grey.shape)["sector"] > 0
    spread = max(spread, _LEAST_SPREAD)
    fan = _TrackedFan(geometry, inner, outer, sector, ground, spread, np.zeros(3), 0.0, 0.0)
    fan.shares = _shares(fan, grey)
    fan.inside = _inside_of(fan, grey)
    fan.outside = _outside_of(fan, grey)
    return fan


def _is_lit(fan: _TrackedFan, grey: UInt8s) -> Bools:
    return np.asarray(np.abs(grey.astype(np.float32) - np.float32(fan.ground)) > fan.spread)


def _shares(fan: _TrackedFan, grey: UInt8s) -> Float64s:
    """(3,) part of the left edge, the right edge and the far arc at which the fan ends."""
    lit = _is_lit(fan, grey).ravel()

    def lit_share(indices: npt.NDArray[np.intp]) -> Float64s:
        within = indices >= 0
        count = np.maximum(within.sum(axis=2), 1)
        return np.asarray((lit[indices] & within).sum(axis=2) / count, np.float64)

    inner = lit_share(fan.inner)
    outer = lit_share(fan.outer)
    return np.asarray(light_ends(inner, outer).mean(axis=1), np.float64)


def _outside_of(fan: _TrackedFan, grey: UInt8s) -> float:
    return float((_is_lit(fan, grey) & ~fan.sector).mean())


def _inside_of(fan: _TrackedFan, grey: UInt8s) -> float:
    return float((_is_lit(fan, grey) & fan.sector).mean())


def _shows_other(fan: _TrackedFan, grey: UInt8s) -> bool:
    """Whether an image in which no fan is found shows a title or a menu, not a fan in the dark."""
    more_outside = _outside_of(fan, grey) > fan.outside + _MORE_OUTSIDE
    return more_outside or _inside_of(fan, grey) < _LEAST_INSIDE * fan.inside


def _is_kept(fan: _TrackedFan, grey: UInt8s) -> bool:
    is_filled = _outside_of(fan, grey) <= fan.outside + _MORE_OUTSIDE
    return is_filled and bool((_shares(fan, grey) >= _KEPT_SHARE * fan.shares).all())


def _is_dark(fan: _TrackedFan, grey: UInt8s) -> bool:
    """Whether an image shows nothing at all, such as one between two recordings."""
    return not bool(_is_lit(fan, grey).mean() > 0.001)


def _thumbnail(grey: UInt8s) -> UInt8s:
    size = (_THUMBNAIL_PX, _THUMBNAIL_PX)
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
