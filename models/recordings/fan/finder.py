"""The geometry of a fan picture, found in the picture itself: where its black border ends.

A fan picture is lit inside a sector and black outside it, mostly with far range on top.  The sector
is found that best tells lit from black pixels (`outline`), and then looked at for how much of
its outline is really there.  Where there is none, the picture is turned by quarters, looked at as a
negative, and what is largest on a screen alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ....factory.sonar.geometry import FanGeometry
from ..palettes import find_painted
from .edges import find_drawn
from .outline import Numbers, Sector, fit_sector, limits

Bytes = npt.NDArray[np.uint8]

_MOST_BLACK = 48
"""Of 255: a border lighter than this is no black one."""
_PAGE_SPREAD = 8  # of 255: a page around a fan is as even as that
_HOLES = np.ones((7, 7), np.uint8)  # of zeros in a fan
_LEAST_PART, _MOST_PART = 0.05, 0.9  # of all pixels: a fan on a screen
SURE = 0.7
"""Fans found with less confidence are not returned."""
_SURE_ODD = 0.8  # turned fans and negatives
_LEAST_TURNED = 0.15  # part of the picture that a turned fan fills, unlike the mask of some object

_SMALLEST = 32  # pixels a side
_MOST_OUTSIDE = 0.05  # of all pixels may be lit and not in the sector
_MOST_SQUEEZE = 1.95
_MOST_MEDIAN = 127  # of 255: of a fan on a bright page
_GROUND_SPREADS = 2, 6  # of 255: the ground of a screen
_DIM = 0.25  # of full scale: pictures that are darker throughout are made brighter
_LEAST_HALF_DEG, _MOST_HALF_DEG = 2.0, 88.0
_PIECES = 12  # of each side of the outline, looked at one by one


@dataclass(frozen=True)
class FoundFan:
    """A fan as it lies in a picture.

    geometry: in pixels and shares of the largest range; metres cannot be seen.
    confidence: 0..1, the share of the outline (both edges and the far arc, in equal parts) at which
        the picture is lit just inside and black just outside.  A fan whose outline is half in the
        dark has 0.5.
    """

    geometry: FanGeometry
    confidence: float


def find_fan(picture: npt.NDArray[Any]) -> FoundFan | None:
    """The fan in (H, W) or (H, W, colours) grey values of any number type, if there is one.

    None for a picture without a sector on black or on a bright page: a photo, a polar picture, a
    full rectangle.  Raises ValueError for another shape.
    """
    grey = _bytes(picture)
    if min(grey.shape) < _SMALLEST:
        return None
    found = _find_upright(grey, SURE) or _find_turned(grey)
    # A video's ground is not quite flat; the wider, the farther it reaches into a fan's grain.
    for spread in _GROUND_SPREADS:
        if found is not None:
            break
        alone = _largest_part(grey, spread)
        if alone is not None:
            found = _find_upright(alone, _SURE_ODD) or _find_turned(alone)
    if found is None and (drawn := find_drawn(grey)) is not None:
        found = FoundFan(*drawn)
    return found


def find_geometry(picture: npt.NDArray[Any]) -> FanGeometry | None:
    """The geometry of the fan that `find_fan` sees, if it sees one."""
    found = find_fan(picture)
    return None if found is None else found.geometry


def _find_turned(grey: Bytes) -> FoundFan | None:
    """The fan with far range elsewhere."""
    for turns in (2, 1, 3):
        found = _find_upright(np.ascontiguousarray(np.rot90(grey, turns)), _SURE_ODD)
        if found is not None:
            geometry = found.geometry.turned_back(turns, *grey.shape)
            if geometry.sector_mask(*grey.shape).mean() >= _LEAST_TURNED:
                return replace(found, geometry=geometry)
    return None


def _find_upright(grey: Bytes, sure: float) -> FoundFan | None:
    """The fan with far range on top."""
    black = _black(grey)
    if black > _MOST_BLACK:
        shown, black = _without_page(grey), 0
        lit = shown[shown > 0]
        if lit.size and np.median(lit) > _MOST_MEDIAN:
            # Echoes are dark on white: the page is part of the scale, nothing there.
            shown, sure = np.subtract(255, grey, dtype=np.uint8), max(sure, _SURE_ODD)
            black = _black(shown)
        elif not lit.size or _corners(shown)[0].any() or _corners(shown)[1].any():
            return None
        if black > _MOST_BLACK:
            return None
        grey = shown
    grey, top, left = _cropped(grey, black)
    sector = fit_sector(grey > black)
    if sector is None:
        return None
    # JPEG and MPEG ring on both sides of an edge: there the border is not quite black.
    ringing = min(_level_beside(grey, sector), _MOST_BLACK)
    if ringing > black:
        again = fit_sector(grey > ringing)
        if again is not None:
            black, sector = ringing, again
    half_deg = np.rad2deg(np.arctan([-sector[4], sector[5]]))
    if half_deg.min() < _LEAST_HALF_DEG or half_deg.max() > _MOST_HALF_DEG:
        return None
    outside = (grey > black) & (_inside(sector, *grey.shape) == 0)
    if outside.mean() > _MOST_OUTSIDE:
        return None
    if abs(math.log(sector[6])) > math.log(_MOST_SQUEEZE):
        return None
    geometry = _geometry(sector)
    confidence = _confidence(grey > black, geometry)
    if confidence < sure:
        return None
    moved = replace(
        geometry, apex_x_px=geometry.apex_x_px + left, apex_y_px=geometry.apex_y_px + top
    )
    return FoundFan(moved, confidence)


def _corners(grey: Bytes) -> tuple[Bytes, Bytes]:
    """Both upper ones, which no fan reaches."""
    size = max(2, min(grey.shape) // 40)
    return grey[:size, :size], grey[:size, -size:]


def _black(grey: Bytes) -> int:
    """The level of the border: the lesser of the corners', as there may be text in the other."""
    return min(int(np.quantile(corner, 0.99)) for corner in _corners(grey))


def _cropped(grey: Bytes, black: int) -> tuple[Bytes, int, int]:
    """What is not border, with some border around it; its first row and column."""
    lit = grey > black
    spans = []
    for share in (lit.mean(axis=1), lit.mean(axis=0)):
        some = np.flatnonzero(share > 0.02)
        ends = (int(some[0]), int(some[-1]) + 1) if len(some) else (0, len(share))
        spans.append(slice(max(ends[0] - 16, 0), ends[1] + 16))
    rows, columns = spans
    return np.ascontiguousarray(grey[rows, columns]), rows.start, columns.start


def _bytes(picture: npt.NDArray[Any]) -> Bytes:
    """(H, W) of 8 bits: grey values, or the levels of a colour map."""
    if picture.ndim == 3:
        painted = find_painted(picture)
        picture = picture[..., :3].max(axis=2) if painted is None else painted.levels
    if picture.ndim != 2:
        raise ValueError(f"picture has shape {picture.shape}; expected (H, W) or (H, W, colours)")
    return _grey_bytes(picture)


def _grey_bytes(picture: npt.NDArray[Any]) -> Bytes:
    if picture.dtype == np.uint8:
        return picture
    full = float(np.iinfo(picture.dtype).max) if picture.dtype.kind in "iu" else 1.0
    # Samples of 10 or 12 bits in files of 16 leave most of the scale empty.
    brightest = float(np.nan_to_num(picture, posinf=0).max(initial=0))
    full = brightest if 0 < brightest < _DIM * full else full
    # A level that is not zero stays one.
    return np.asarray(np.ceil(np.clip(np.nan_to_num(picture / full), 0, 1) * 255), np.uint8)


def _inside(sector: Sector, height: int, width: int) -> Bytes:
    (top,), (bottom,) = limits(np.array([sector]), np.arange(width, dtype=np.float64))
    row = np.arange(height)[:, None]
    inside: Bytes = ((row >= top) & (row <= bottom)).astype(np.uint8)
    return inside


def _level_beside(grey: Bytes, sector: Sector) -> int:
    """The level below which 97 % of the pixels lie that are 2 to 8 pixels outside the sector."""
    inside = _inside(sector, *grey.shape)
    near = cv2.dilate(inside, np.ones((5, 5), np.uint8))
    wide = cv2.dilate(inside, np.ones((17, 17), np.uint8))
    beside = grey[(wide > 0) & (near == 0)]
    return int(np.quantile(beside, 0.97)) if beside.size else 0


def _geometry(sector: Sector) -> FanGeometry:
    apex_x, apex_y, far, near, left, right, squeeze = sector
    first, last = math.atan(left), math.atan(right)
    return FanGeometry(
        "fan",
        near_fraction=near / far,
        sector_rad=2 * max(-first, last),
        azimuth_min_rad=first,
        azimuth_max_rad=last,
        apex_x_px=apex_x,
        apex_y_px=apex_y,
        far_px=far,
        x_scale=squeeze,
    )


def _confidence(lit: npt.NDArray[np.bool_], fan: FanGeometry) -> float:
    """See `FoundFan`."""
    count = _PIECES * 12
    # Some pixels away from the outline, as shares of the largest range.
    away = np.maximum(np.linspace(0.004, 0.02, 5), np.arange(2, 7) / fan.far_px)
    ranges = np.linspace(fan.near_fraction + 0.03, 0.97, count)[:, None]
    bearings = np.linspace(fan.azimuth_min_rad, fan.azimuth_max_rad, count + 8)[4:-4, None]
    seen = []
    for edge_rad, side in ((fan.azimuth_min_rad, -1.0), (fan.azimuth_max_rad, 1.0)):
        inner = _lit_share(lit, fan, ranges, edge_rad - side * away / ranges)
        outer = _lit_share(lit, fan, ranges, edge_rad + side * away / ranges)
        seen.append(_seen(inner, outer))
    inner = _lit_share(lit, fan, 1 - away, bearings)
    outer = _lit_share(lit, fan, 1 + away, bearings)
    seen.append(_seen(inner, outer))
    return float(np.mean(seen))


def _seen(inner: Numbers, outer: Numbers) -> npt.NDArray[np.bool_]:
    # Outside the picture all is black, and inside there must be something.
    inner, outer = np.nan_to_num(inner), np.nan_to_num(outer)
    return np.asarray((inner > 0.1) & (outer < 0.35 * inner))


def _lit_share(
    lit: npt.NDArray[np.bool_],
    fan: FanGeometry,
    ranges: npt.NDArray[Any],
    bearings: npt.NDArray[Any],
) -> Numbers:
    """(_PIECES,) share of lit pixels of each piece of the outline, NaN outside the picture."""
    height, width = lit.shape
    row, column = (np.rint(place).astype(int) for place in fan.pixels(ranges, bearings))
    row, column = np.broadcast_arrays(row, column)
    there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    hit = there & lit[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)]
    counts = there.reshape(_PIECES, -1).sum(axis=1)
    share = hit.reshape(_PIECES, -1).sum(axis=1) / np.maximum(counts, 1)
    return np.where(counts > 0, share, np.nan)


def border(grey: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The outermost pixels of (H, W), in one row."""
    return np.concatenate([grey[0], grey[-1], grey[:, 0], grey[:, -1]])


def _without_page(grey: Bytes) -> Bytes:
    """Black where a page of one bright grey reaches in from the picture's border."""
    ground = _ground(grey, int(np.median(border(grey))), _PAGE_SPREAD)
    # JPEG rings beside the page.
    return np.where(cv2.dilate(ground, np.ones((3, 3), np.uint8)) > 0, 0, grey).astype(np.uint8)


def _largest_part(grey: Bytes, spread: int) -> Bytes | None:
    """What is largest on a flat ground, alone on black: a fan amid text and panels."""
    ground = int(np.median(border(grey)))
    shown = grey
    if ground > spread:
        shown = np.where(_ground(grey, ground, spread) > 0, 0, grey).astype(np.uint8)
    lit = cv2.morphologyEx((shown > spread).astype(np.uint8), cv2.MORPH_CLOSE, _HOLES)
    count, parts, stats, _ = cv2.connectedComponentsWithStats(lit, connectivity=4)
    if count < 3:
        return None  # a single one is no other picture than before
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    if not _LEAST_PART <= stats[largest, cv2.CC_STAT_AREA] / grey.size <= _MOST_PART:
        return None
    return np.where(parts == largest, shown, 0).astype(np.uint8)


def _ground(grey: Bytes, level: int, spread: int) -> Bytes:
    """1 where pixels of a level reach in from the picture's border, else 0."""
    alike = (np.abs(grey.astype(np.int16) - level) <= spread).astype(np.uint8)
    _, parts = cv2.connectedComponents(alike, connectivity=4)
    return np.isin(parts, np.setdiff1d(border(parts), 0)).astype(np.uint8)
