"""What lies around sonar pictures: black, a bright page, axes and text, the ground of a screen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

Bytes = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]

MOST_BLACK = 48
"""Of 255: a border lighter than this is no black one."""
_PAGE_SPREAD = 8  # of 255: a page around a fan is as even as that
_HOLES = np.ones((7, 7), np.uint8)  # of zeros in a fan
_LEAST_PART, _MOST_PART = 0.05, 0.9  # of all pixels: a fan on a screen

_EVEN, _EVEN_SHARE = 2, 0.9  # of 255: so much of a figure's border is of one grey
_LIGHT, _PAGE_SHARE = 190, 0.5  # of 255, and of all pixels: the page of a figure without pictures
_ENCLOSED_PX = 12  # page that lines enclose, as between axes and a fan
_LINES = np.ones((7, 7), np.uint8)  # what vanishes of a figure: axes, ticks, letters
_LEAST_SIDE_PX, _LEAST_SHARE = 32, 0.02  # of a picture in a figure
_MOST_FRAME_PX = 12
_LINE_PX, _LINE_PART = 64, 8  # least length of an axis: pixels, and the part of the figure's side
_LINE_WIDTH_PX = 6
_RECTANGULAR = 0.95


def border(grey: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """The outermost pixels of (H, W), in one row."""
    return np.concatenate([grey[0], grey[-1], grey[:, 0], grey[:, -1]])


def without_page(grey: Bytes) -> Bytes:
    """Black where a page of one bright grey reaches in from the picture's border."""
    ground = _ground(grey, int(np.median(border(grey))), _PAGE_SPREAD)
    # JPEG rings beside the page.
    return np.where(cv2.dilate(ground, np.ones((3, 3), np.uint8)) > 0, 0, grey).astype(np.uint8)


def largest_part(grey: Bytes, spread: int) -> Bytes | None:
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


@dataclass(frozen=True, eq=False)
class Part:
    """A picture within a figure.

    rows, columns: where it is.  inside: (rows, columns) which of these pixels are its own.
    """

    rows: slice
    columns: slice
    inside: Mask

    def of(self, picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """This part of a picture, (H, W), without what is not its own."""
        return np.where(self.inside, picture[self.rows, self.columns], picture.dtype.type(0))

    def alone(self, picture: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """(H, W): the picture, black but for this part."""
        black = np.zeros_like(picture)
        black[self.rows, self.columns] = self.of(picture)
        return black


def parts_of_figure(grey: Bytes, *, dark: bool = False) -> tuple[Part, ...] | None:
    """The pictures on a bright page of one grey, largest first, without axes, text and colour bars.

    grey: (H, W).  dark: of a dark page, too, but rectangles alone: what else is on black may well
    be one picture in parts.  Empty where there is nothing but lines and text, or nothing at all;
    None for what is no figure.
    """
    edge = border(grey).astype(np.float32)
    level = float(np.median(edge))
    rectangles = level <= MOST_BLACK
    if (rectangles and not dark) or (np.abs(edge - level) <= _EVEN).mean() < _EVEN_SHARE:
        return None
    alike = (np.abs(grey.astype(np.int16) - level) <= _EVEN).astype(np.uint8)
    _, areas, stats, _ = cv2.connectedComponentsWithStats(alike, connectivity=4)
    large = stats[:, cv2.CC_STAT_AREA] >= _ENCLOSED_PX
    large[0] = False
    page = large[areas]
    rest = (~page & ~_axes(grey, page)).astype(np.uint8)
    solid = cv2.morphologyEx(rest, cv2.MORPH_OPEN, _LINES)
    count, parts, stats, _ = cv2.connectedComponentsWithStats(solid, connectivity=4)
    found = []
    for number in sorted(range(1, count), key=lambda one: -stats[one, cv2.CC_STAT_AREA]):
        if stats[number, cv2.CC_STAT_AREA] < _LEAST_SHARE * grey.size:
            break
        whole = np.asarray(ndimage.binary_fill_holes(parts == number))
        part = _part(grey, whole, stats[number], rectangles)
        if part is not None:
            found.append(part)
    if not found and (level < _LIGHT or page.mean() < _PAGE_SHARE):
        return None
    return tuple(found)


def _axes(grey: Bytes, page: Mask) -> Mask:
    """Long thin lines of one grey along rows or columns by the page: around a figure's pictures."""
    found = np.zeros(grey.shape, np.uint8)
    for axis in (0, 1):
        steps = np.abs(np.diff(grey.astype(np.int16), axis=axis, prepend=0)) <= _EVEN
        length = max(_LINE_PX, grey.shape[axis] // _LINE_PART)
        kernel = np.ones((length, 1) if axis == 0 else (1, length), np.uint8)
        long = cv2.morphologyEx((steps & ~page).astype(np.uint8), cv2.MORPH_OPEN, kernel)
        found = np.maximum(found, long).astype(np.uint8)
    wide = np.ones((2 * _LINE_WIDTH_PX + 1,) * 2, np.uint8)
    beside = cv2.dilate(page.astype(np.uint8), wide)
    return np.asarray((found > cv2.morphologyEx(found, cv2.MORPH_OPEN, wide)) & (beside > 0))


def _part(grey: Bytes, inside: Mask, stats: npt.NDArray[Any], rectangles: bool) -> Part | None:
    """None for what is no picture: small, or of one colour along rows or columns, as scales are."""
    left, top, width, height = (int(one) for one in stats[:4])
    rows, columns = slice(top, top + height), slice(left, left + width)
    if inside[rows, columns].mean() >= _RECTANGULAR:
        rows, columns = _without_frame(grey, inside, rows, columns)
        inside = np.ones_like(inside)
    elif rectangles:
        return None
    inside = inside[rows, columns]
    if min(inside.shape) < _LEAST_SIDE_PX:
        return None
    for axis in (0, 1):
        few, most = np.percentile(grey[rows, columns], (25, 75), axis=axis)
        if np.median(most - few) <= _EVEN:
            return None
    return Part(rows, columns, inside)


def _without_frame(grey: Bytes, inside: Mask, rows: slice, columns: slice) -> tuple[slice, slice]:
    """A rectangle without rows and columns at its sides that are of one grey, or lie outside."""
    top, bottom, left, right = rows.start, rows.stop, columns.start, columns.stop

    def even(*line: Any) -> bool:
        values = grey[line]
        alike = np.abs(values - np.median(values)) <= _EVEN
        return bool(max(alike.mean(), 1 - inside[line].mean()) >= _EVEN_SHARE)

    for _ in range(_MOST_FRAME_PX):
        if bottom - top <= _LEAST_SIDE_PX or right - left <= _LEAST_SIDE_PX:
            break
        top += even(top, slice(left, right))
        bottom -= even(bottom - 1, slice(left, right))
        left += even(slice(top, bottom), left)
        right -= even(slice(top, bottom), right - 1)
    return slice(top, bottom), slice(left, right)


def _ground(grey: Bytes, level: int, spread: int) -> Bytes:
    """1 where pixels of a level reach in from the picture's border, else 0."""
    alike = (np.abs(grey.astype(np.int16) - level) <= spread).astype(np.uint8)
    _, parts = cv2.connectedComponents(alike, connectivity=4)
    return np.isin(parts, np.setdiff1d(border(parts), 0)).astype(np.uint8)
