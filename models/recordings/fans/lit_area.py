"""The part of an image that may hold a fan: without its black margins, or alone on a screen."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ....factory.common.array_types import Bools, Float64s, UInt8s

_MIN_LIT_SHARE = 0.02  # of a row or column that is not black
_MARGIN_PX = 16
_MIN_AREA = 0.05  # of all pixels: the smallest fan on a screen
_MAX_AREA = 0.9  # the largest


class Crop(NamedTuple):
    """A part of an image, and its first row and column."""

    grey: UInt8s
    top: int
    left: int


def crop_lit_area(grey: UInt8s, black: int) -> Crop:
    """The part of an image that is not black, with a margin.

    black: the largest grey value that counts as black.
    """
    lit = grey > black
    rows = _lit_span(lit.mean(axis=1))
    columns = _lit_span(lit.mean(axis=0))
    return Crop(np.ascontiguousarray(grey[rows, columns]), rows.start, columns.start)


def _lit_span(lit_shares: Float64s) -> slice:
    """The span of rows or columns that are not black, with a margin; all where every one is.

    lit_shares: share of lit pixels in each row or column.
    """
    lit_lines = np.flatnonzero(lit_shares > _MIN_LIT_SHARE)
    first = 0
    last = len(lit_shares) - 1
    if len(lit_lines):
        first = int(lit_lines[0])
        last = int(lit_lines[-1])
    return slice(max(first - _MARGIN_PX, 0), last + _MARGIN_PX + 1)


def isolate_largest_area(grey: UInt8s, ground_spread: int) -> UInt8s | None:
    """Blacken all but the largest area on the flat ground of a screen, which may hold a fan.

    ground_spread: grey levels by which the ground may vary.
    None where the area is too small or too large, or nothing else is there.
    """
    is_rim = np.ones(grey.shape, bool)
    is_rim[1:-1, 1:-1] = False
    ground_level = int(np.median(grey[is_rim]))
    has_bright_ground = ground_level > ground_spread
    on_black = grey
    if has_bright_ground:
        has_ground_level = np.abs(grey.astype(np.int16) - ground_level) <= ground_spread
        on_black = _blacken_ground(grey, has_ground_level, is_rim)

    is_lit = (on_black > ground_spread).astype(np.uint8)
    closed = cv2.morphologyEx(is_lit, cv2.MORPH_CLOSE, np.ones((7, 7), np.uint8))
    label_count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=4)
    area_count = label_count - 1  # label 0 is the ground
    # A single area on black would be the image that was searched already.
    min_count = 1 if has_bright_ground else 2
    if area_count < min_count:
        return None

    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    area = stats[largest, cv2.CC_STAT_AREA] / grey.size
    if not _MIN_AREA <= area <= _MAX_AREA:
        return None
    return np.where(labels == largest, on_black, 0).astype(np.uint8)


def _blacken_ground(grey: UInt8s, has_ground_level: Bools, is_rim: Bools) -> UInt8s:
    """Blacken all of the ground's level that is connected to the rim of the image."""
    _, labels = cv2.connectedComponents(has_ground_level.astype(np.uint8), connectivity=4)
    ground_labels = np.setdiff1d(labels[is_rim], 0)  # 0: pixels of other levels
    return np.where(np.isin(labels, ground_labels), 0, grey).astype(np.uint8)
