"""White and grey lines that somebody drew over a fan: rings of range and bearings.

Colours tell marks from echoes elsewhere (`simnfnd.models.recordings.palettes`); over a grey fan it
is that a line is narrow and nearly as bright all along, as no echoes are.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ....factory.sonar.geometry import FanGeometry
from ..marks import means_around

Gray = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]

_ALONG = 400
"""Places that are looked at along a ring or a bearing."""
_SIDE, _SIDE_AT_FAR = 4, 10
"""Distance of the ground that a line is compared with, pixels; bearings lie apart at far range."""
_STEADY, _STEADY_BRIGHT = 0.02, 0.2
"""How much three fifths of a line may differ; bright ones more, for smoothed ones lie between two
pixels."""
_BRIGHT = 0.6
_CONTRAST = 0.12
_LEAST_LEVEL = 0.1
_NEAREST_PX = 15
"""Nearer the first range there are bright arcs of the sonar itself."""
_BEARINGS_FROM = 0.25
"""Bearings are looked at from this part of the largest range on, where they lie apart."""
_EDGE = 0.97
_PART = 0.3
"""Of a line's contrast: what is brighter beside it belongs to it."""
_OF_IT, _WIDE = 0.25, 0.5
"""Part of the pixels at one distance from a line that are bright: of its own, and of a wide one."""
_WIDER = 1.35
_AROUND_PX = 9


def without_lines(grey: Gray, fan: FanGeometry | None) -> tuple[Gray, Mask] | None:
    """The picture with the ground's level where lines are drawn, and where that is; None: nowhere.

    grey: (H, W) in 0..1.  fan: where its range and bearing are.
    """
    if fan is None or fan.layout == "polar":
        return None
    most = float(grey.max())
    full = grey / np.float32(most or 1)
    rings = list(_rings(full, fan))
    # A spoke can look like the line of a bearing; who draws bearings draws rings, too.
    if not rings:
        return None
    maps = fan.maps(0, 0, *grey.shape)
    range_px = maps["range_fraction"] * np.float32(fan.far_px)
    drawn = np.zeros(grey.shape, bool)
    for line in (*rings, *_bearings(full, fan)):
        if line.of_range:
            beside = range_px - np.float32(line.place)
        else:
            beside = range_px * (maps["azimuth_rad"] - np.float32(line.place))
        pixels = _across(beside, grey >= np.float32(line.least * most), maps["sector"] > 0)
        if line.of_range or not _widens(pixels, range_px):
            drawn |= pixels
    if not drawn.any():
        return None
    return filled(grey, drawn), drawn


def _across(beside_px: Gray, bright: Mask, inside: Mask) -> Mask:
    """The bright pixels at those distances from a line at which many are; none of a wide one."""
    place = np.rint(beside_px * 2).astype(np.int64) + 2 * _SIDE
    near = inside & (place >= 0) & (place <= 4 * _SIDE)
    count = np.bincount(place[near], minlength=4 * _SIDE + 1)
    lit = np.bincount(place[near & bright], minlength=4 * _SIDE + 1)
    part = lit / np.maximum(count, 1)
    if max(part[0], part[-1]) > _WIDE:
        return np.zeros_like(bright)
    of_line = (part > _OF_IT)[np.clip(place, 0, 4 * _SIDE)]
    return np.asarray(near & bright & of_line)


def _widens(pixels: Mask, range_px: Gray) -> bool:
    """Whether a bearing's line is wider far away: a beam that is too bright, and no pen."""
    ranges = range_px[pixels]
    if not len(ranges):
        return False
    count, _ = np.histogram(ranges, np.linspace(ranges.min(), ranges.max(), 3))
    return bool(count[1] > _WIDER * max(count[0], 1))


def filled(grey: Gray, drawn: Mask) -> Gray:
    """The mean of what is around them where marks are drawn."""
    means, known = means_around(grey, ~drawn, _AROUND_PX)
    return np.where(drawn & known, means, grey).astype(np.float32)


@dataclass(frozen=True)
class _Line:
    """place: range, pixels, or bearing, rad.  least: grey value of it."""

    of_range: bool
    place: float
    least: float


def _rings(grey: Gray, fan: FanGeometry) -> Iterator[_Line]:
    near_px = fan.near_fraction * fan.far_px
    places = np.arange(near_px + _NEAREST_PX - _SIDE, fan.far_px + _SIDE)
    across = _middle(fan) + np.linspace(-_EDGE, _EDGE, _ALONG) * fan.sector_rad / 2
    rows = _sampled(grey, *fan.pixels(*np.meshgrid(places / fan.far_px, across, indexing="ij")))
    for row, least in _steady_rows(rows, _SIDE):
        yield _Line(True, float(places[row]), least)


def _bearings(grey: Gray, fan: FanGeometry) -> Iterator[_Line]:
    beyond_rad = fan.sector_rad / 2 + _SIDE_AT_FAR / fan.far_px
    places = _middle(fan) + np.arange(-beyond_rad, beyond_rad, 1 / fan.far_px)
    along = np.linspace(max(fan.near_fraction, _BEARINGS_FROM), 0.99, _ALONG)
    rows = _sampled(grey, *fan.pixels(*np.meshgrid(along, places)))
    for row, least in _steady_rows(rows, _SIDE_AT_FAR):
        yield _Line(False, float(places[row]), least)


def _middle(fan: FanGeometry) -> float:
    return (fan.azimuth_min_rad + fan.azimuth_max_rad) / 2


def _sampled(grey: Gray, row: npt.NDArray[np.floating], column: npt.NDArray[np.floating]) -> Gray:
    """The nearest pixels, -1 outside of the picture."""
    height, width = grey.shape
    row, column = np.rint(row).astype(np.int64), np.rint(column).astype(np.int64)
    there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    found = grey[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    return np.where(there, found, np.float32(-1))


def _steady_rows(rows: Gray, side: int) -> Iterator[tuple[int, float]]:
    """The middle of neighbouring rows that hold one line, and the least grey value of it.

    rows: samples along each, -1 where there are none.  side: how many rows beside it is the ground.
    """
    brightest = np.maximum(rows, np.maximum(np.roll(rows, 1, axis=0), np.roll(rows, -1, axis=0)))
    brightest[rows < 0] = -1
    line, ground = _quantiles(brightest), _quantiles(rows)
    there = (rows >= 0).mean(axis=1) > 0.5
    level = line[:, 1]
    spread = line[:, 2] - line[:, 0]
    allowed = np.where(level >= _BRIGHT, _STEADY_BRIGHT, _STEADY)
    good = there & (spread <= allowed) & (level >= _LEAST_LEVEL)
    beside = np.zeros(len(rows))
    for shift in (-side, side):
        median, upper = (np.roll(ground[:, one], shift) for one in (1, 2))
        known = np.roll(there, shift)
        good &= ~known | ((median < level - _CONTRAST) & (upper < level - _CONTRAST / 2))
        beside = np.maximum(beside, np.where(known, median, 0))
    good[:side] = good[-side:] = False
    least = beside + _PART * (level - beside)
    numbers = np.flatnonzero(good)
    for together in np.split(numbers, np.flatnonzero(np.diff(numbers) > 2) + 1):
        if len(together):
            yield round(float(together.mean())), float(least[together].max())


def _quantiles(rows: Gray) -> npt.NDArray[np.float64]:
    """(rows, 3): the second, the middle and the eighth tenth of what is there in each."""
    ordered = np.sort(rows, axis=1)
    missing = (rows < 0).sum(axis=1)
    there = np.maximum(rows.shape[1] - missing, 1)
    place = missing[:, None] + np.array([0.2, 0.5, 0.8]) * (there - 1)[:, None]
    index = np.minimum(np.rint(place).astype(np.int64), rows.shape[1] - 1)
    return np.take_along_axis(ordered, index, axis=1).astype(np.float64)
