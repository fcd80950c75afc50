"""What lies around a fan: black, a bright page, or the ground of a screen with text and panels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Bytes = npt.NDArray[np.uint8]

MOST_BLACK = 48
"""Of 255: a border lighter than this is no black one."""
_PAGE_SPREAD = 8  # of 255: a page around a fan is as even as that
_HOLES = np.ones((7, 7), np.uint8)  # of zeros in a fan
_LEAST_PART, _MOST_PART = 0.05, 0.9  # of all pixels: a fan on a screen


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


def _ground(grey: Bytes, level: int, spread: int) -> Bytes:
    """1 where pixels of a level reach in from the picture's border, else 0."""
    alike = (np.abs(grey.astype(np.int16) - level) <= spread).astype(np.uint8)
    _, parts = cv2.connectedComponents(alike, connectivity=4)
    return np.isin(parts, np.setdiff1d(border(parts), 0)).astype(np.uint8)
