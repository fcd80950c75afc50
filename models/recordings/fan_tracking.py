"""The fan of each frame of a recording: searched where its outline changes, else kept.

An operator switches the range, a title comes before the first ping, a menu covers the fan for some
seconds.  To search each frame anew would cost more than the network and make the fan tremble, so
the outline that was found last is looked at first.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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
_MORE_OUTSIDE = 0.02  # part of the image: text and menus where there was nothing
_LEAST_INSIDE = 0.2  # of what was lit in the fan when it was found
_SAME_PX = 2.0
_SAME_SHARE = 0.01
_SAME_RAD = math.radians(0.5)
_THUMBNAIL_PX = 16
_LEAST_CUT = 1.0
_CUT_OF_USUAL = 4.0
"""Mean difference of thumbnails after a cut: of 255, and times the usual one."""
_SHARE_OF_NEWEST = 0.1  # in the usual difference
_LONGEST_PAUSE = 32  # frames between two searches where none finds a fan
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


class FanTracker:
    """Follows the fan through images of one size.

    searched: in how many images it was searched.  fans_found: in how many of them it was there.
    changes: how often it was another one than before.
    """

    def __init__(self) -> None:
        self.searched = self.fans_found = self.changes = 0
        self._fan: _TrackedFan | None = None
        self._is_away = False
        self._pause = self._waited = 0
        self._before: UInt8s | None = None
        self._searched_in_vain: UInt8s | None = None
        self._usual_change: float | None = None
        self._is_cut = False

    def geometry(self, image: Array) -> FanGeometry | None:
        """The fan of the next image, (H, W) or (H, W, colours); None where it shows none."""
        grey = grey_bytes(image)
        self._look(grey)
        fan = self._fan
        if fan is not None:
            if _is_kept(fan, grey):
                self._is_away = False
                return fan.geometry
            if _is_dark(fan, grey):
                return None if self._is_away else fan.geometry
        if (fan is None or self._is_away) and not self._is_due():
            return None
        return self._searched(image, grey)

    def _searched(self, image: Array, grey: UInt8s) -> FanGeometry | None:
        """Search an image for its fan: the fan so far where it is still there, else what was found.

        After searches in vain the next ones wait longer and longer.
        """
        geometry = find_geometry(image)
        self.searched += 1
        fan = self._fan
        if geometry is None:
            self._pause = min(2 * self._pause + 1, _LONGEST_PAUSE)
            self._waited = 0
            self._searched_in_vain = self._before
            if fan is None or _shows_other(fan, grey):
                self._is_away = True
                return None
            # Nothing is around it: parts of its outline are in the dark, no more.
            fan.shares = np.minimum(fan.shares, _shares(fan, grey))
            return fan.geometry
        self.fans_found += 1
        self._is_away = False
        self._pause = 0
        if fan is not None and _is_same(fan.geometry, geometry):
            fan.shares = np.minimum(fan.shares, _shares(fan, grey))
            return fan.geometry
        self.changes += fan is not None
        self._fan = _fan_of(geometry, grey)
        return geometry

    def _is_due(self) -> bool:
        """Whether to search after searches that failed: ever more rarely, and after a cut."""
        self._waited += 1
        if self._is_cut:
            self._pause = 0
        return self._waited > self._pause or self._shows_something_else()

    def _shows_something_else(self) -> bool:
        """Whether the image is unlike the last one in which no fan was found."""
        thumbnail = self._before
        searched = self._searched_in_vain
        if thumbnail is None or searched is None:
            return False
        apart = float(np.abs(thumbnail.astype(np.float64) - searched).mean())
        brightness = max(float(thumbnail.mean()), float(searched.mean()))
        return apart > max(_LEAST_CUT, _OTHER_IMAGE * brightness)

    def _look(self, grey: UInt8s) -> None:
        """Notes whether the image differs from the one before as images do after a cut."""
        thumbnail = _thumbnail(grey)
        before = self._before
        self._before = thumbnail
        if before is None:
            return
        change = float(np.abs(thumbnail.astype(np.float64) - before).mean())
        usual = change if self._usual_change is None else self._usual_change
        self._is_cut = change > max(_LEAST_CUT, _CUT_OF_USUAL * usual)
        self._usual_change = usual + _SHARE_OF_NEWEST * (change - usual)


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
    return bool((_shares(fan, grey) >= _KEPT_SHARE * fan.shares).all())


def _is_dark(fan: _TrackedFan, grey: UInt8s) -> bool:
    """Whether an image shows nothing at all, such as one between two recordings."""
    return not bool(_is_lit(fan, grey).mean() > 0.001)


def _is_same(geometry: FanGeometry, reference: FanGeometry) -> bool:
    """Whether two fans are one, as exactly as fans are found."""
    if geometry.quarter_turns != reference.quarter_turns:
        return False
    near_px = max(_SAME_PX, _SAME_SHARE * geometry.far_px)
    lengths = ("apex_x_px", "apex_y_px", "far_px")
    angles = ("azimuth_min_rad", "azimuth_max_rad")
    return all(
        abs(getattr(geometry, name) - getattr(reference, name)) <= near_px for name in lengths
    ) and all(
        abs(getattr(geometry, name) - getattr(reference, name)) <= _SAME_RAD for name in angles
    )


def _thumbnail(grey: UInt8s) -> UInt8s:
    size = (_THUMBNAIL_PX, _THUMBNAIL_PX)
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
