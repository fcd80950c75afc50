"""The mean of a frame and its neighbours, laid over each other, where the scene stands still."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from .static import Gray, Mask, likeness, shift_px, shifted

LEAST_ALIKE = 0.3
"""Neighbours in time whose scenes correlate less show something else.  Raw pings of one scene do by
.3 to .5, exported pictures by .85 and more; pictures of different scenes hardly ever by .3."""

_FURTHEST_PX = 4.0
_MOVED = 4.0  # times the usual difference: there something moved
_LEVELS = 12  # of brightness, each with a usual difference of its own
_KEPT_SHIFTS = 4096

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Average:
    """picture: float32, as the frame.  frames: how many went into a pixel of the sector, mean."""

    picture: Gray
    frames: float


class Averager:
    """Averages pictures with their neighbours; remembers how far each two of them are shifted."""

    def __init__(self) -> None:
        self._shifts: dict[tuple[Hashable, Hashable], tuple[float, float] | None] = {}

    def __call__(self, own: Hashable, window: Mapping[Any, Gray], sector: Mask) -> Average:
        """The picture `own` of the window with those of the others that fit.

        window: (H, W) or (H, W, C) float32 in 0..1, each under a name that is its own.
        sector: (H, W) bool, what the picture shows of the fan.
        A neighbour is left out where it has another size, shows something else or moved by more
        than 4 pixels, and in those pixels in which something moved.
        """
        picture = window[own]
        grey = _grey(picture)
        total, count = picture.astype(np.float64), np.ones(grey.shape, np.float64)
        for name, other in window.items():
            if name == own or other.shape != picture.shape:
                continue
            shift = self._shift(own, name, grey, _grey(other), sector)
            if shift is None:
                continue
            laid = shifted(other, np.array(shift)).reshape(picture.shape)
            still = _still(grey, _grey(laid), sector)
            total += np.where(_as(still, picture), laid, 0)
            count += still
        mean = np.clip(total / _as(count, picture), 0, 1).astype(np.float32)
        # Outside the sector there is nothing to average.
        found = np.where(_as(sector, picture), mean, picture)
        return Average(found, float(count[sector].mean()) if sector.any() else 1.0)

    def _shift(
        self, own: Hashable, name: Hashable, grey: Gray, other: Gray, sector: Mask
    ) -> tuple[float, float] | None:
        """How far right and down the scene of `own` lies in the other; None when it does not."""
        known = self._shifts.get((name, own))
        if (name, own) in self._shifts:
            return None if known is None else (-known[0], -known[1])
        if likeness(grey, other, sector) < LEAST_ALIKE:
            shift = None
        else:
            shift = shift_px(grey, other, sector)
            if shift is not None and np.hypot(*shift) > _FURTHEST_PX:
                shift = None
        if len(self._shifts) >= _KEPT_SHIFTS:
            self._shifts.clear()
        self._shifts[own, name] = shift
        return shift


def windows(items: Iterable[T], reach: int) -> Iterator[tuple[int, list[T]]]:
    """Each item's place in the list of it and up to `reach` neighbours before and after it."""
    seen: list[T] = []
    place = 0  # of the next item to be given
    for item in items:
        seen.append(item)
        if len(seen) - place > reach:
            yield place, list(seen)
            place, seen = _next(place, seen, reach)
    while place < len(seen):
        yield place, list(seen)
        place, seen = _next(place, seen, reach)


def _next(place: int, seen: list[T], reach: int) -> tuple[int, list[T]]:
    """The next place, among those items that it and later ones need."""
    return (place + 1, seen) if place < reach else (place, seen[1:])


def _still(own: Gray, other: Gray, sector: Mask) -> Mask:
    """(H, W) bool: where the smoothed pictures differ as much as noise makes them.

    Noise grows with brightness, so the usual difference is one of each level; but not more than
    twice that of the sector, or what alone is bright could never be seen to move.
    """
    smooth = cv2.GaussianBlur(own, (0, 0), 2.0)
    difference = cv2.GaussianBlur(other, (0, 0), 2.0) - smooth
    inside = difference[sector]
    if not inside.size:
        return np.ones(own.shape, bool)
    difference = np.abs(difference - np.median(inside))
    usual = float(np.median(difference[sector]))
    edges = np.quantile(smooth[sector], np.linspace(0, 1, _LEVELS + 1)[1:-1])
    level = np.digitize(smooth, edges)
    limits = np.full(_LEVELS, usual)
    for number in range(_LEVELS):
        here = difference[sector & (level == number)]
        if here.size:
            limits[number] = min(float(np.median(here)), 2 * usual)
    # 1.48: from the median of absolute values to a standard deviation.
    moved = (difference > _MOVED * 1.48 * limits[level]) & sector
    wide = cv2.dilate(moved.astype(np.uint8), np.ones((7, 7), np.uint8))
    return np.asarray(wide == 0)


def _grey(picture: Gray) -> Gray:
    return picture if picture.ndim == 2 else np.asarray(picture.mean(axis=2), np.float32)


def _as(plane: npt.NDArray[Any], picture: Gray) -> npt.NDArray[Any]:
    return plane if picture.ndim == 2 else plane[..., None]
