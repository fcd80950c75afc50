"""A fan on a screen whose edges are drawn as white lines, while what is inside them is half dark.

Chart plotters show such: a V of two lines from the sonar on, and thin arcs of range.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ....factory.sonar.geometry import FanGeometry

_WHITE = 200  # of 255
_WIDE = np.ones((9, 9), np.uint8)  # echoes and panels are as wide as that, lines are not
_LEAST_PART = 0.2  # of the picture's width: a line's length
_LEAST_DEG, _MOST_DEG = 3.0, 75.0  # a line's angle against the picture's rows
_ALIKE_DEG = 1.0  # by which both angles may differ
_GAP_PX = 12.0  # between the sonar and the beginning of a line
_TRIED = 8  # of the longest lines
_MOST_DRAWN = 0.05  # of the picture: where more is thin and bright, it is speckle
_ARC_SHARE = 0.35  # of an arc within the picture that must be white


def find_drawn(grey: npt.NDArray[np.uint8]) -> tuple[FanGeometry, float] | None:
    """The fan between two white lines as far as the outermost arc, and how much of that is seen.

    grey: (H, W), or levels of a map, of which white is the highest.
    """
    mask = (grey >= _WHITE).astype(np.uint8)
    lines = mask - cv2.morphologyEx(mask, cv2.MORPH_OPEN, _WIDE)
    height, width = lines.shape
    if lines.mean() > _MOST_DRAWN:
        return None
    found = cv2.HoughLinesP(lines, 1, math.radians(0.25), 100, None, _LEAST_PART * width, _GAP_PX)
    if found is None:
        return None
    left: list[tuple[float, ...]] = []
    right: list[tuple[float, ...]] = []
    for x1, y1, x2, y2 in found.reshape(-1, 4).astype(float):
        slope = math.degrees(math.atan2(y2 - y1, x2 - x1))  # x1 <= x2
        if _LEAST_DEG <= abs(slope) <= _MOST_DEG:
            (left if slope > 0 else right).append((math.hypot(x2 - x1, y2 - y1), slope, x1, y1))
    for _, down, x1, y1 in sorted(left, reverse=True)[:_TRIED]:
        for _, up, x2, y2 in sorted(right, reverse=True)[:_TRIED]:
            # Where both meet is the sonar.
            fall, rise = math.tan(math.radians(down)), math.tan(math.radians(up))
            x = (y2 - y1 + fall * x1 - rise * x2) / (fall - rise)
            y = y1 + fall * (x - x1)
            if abs(down + up) > _ALIKE_DEG or not (0 < x < width and height / 2 < y < height):
                continue
            half = math.pi / 2 - math.radians(down - up) / 2
            arc = _farthest_arc(lines, x, y, half)
            if arc is not None:
                far, seen = arc
                return FanGeometry.fan(
                    2 * half, apex_x_px=x, apex_y_px=y, near_px=0.0, far_px=far
                ), seen
    return None


def _farthest_arc(
    lines: npt.NDArray[Any], x: float, y: float, half: float
) -> tuple[float, float] | None:
    """Radius of the outermost circle about the sonar that is drawn within the fan, and its share.

    None where there is none.
    """
    height, width = lines.shape
    bearings = np.linspace(-half, half, 720)[10:-10]
    radii = np.arange(height / 4, math.hypot(width, height))[:, None]
    column = np.rint(x + radii * np.sin(bearings)).astype(int)
    row = np.rint(y - radii * np.cos(bearings)).astype(int)
    there = (row >= 0) & (row < height) & (column >= 0) & (column < width)
    near = cv2.dilate(lines, np.ones((3, 3), np.uint8))
    lit = near[np.clip(row, 0, height - 1), np.clip(column, 0, width - 1)] * there
    count = there.sum(axis=1)
    share = np.where(count >= 180, lit.sum(axis=1) / np.maximum(count, 1), 0)
    arcs = np.flatnonzero(share >= _ARC_SHARE)
    return (float(radii[arcs[-1], 0]), float(share[arcs[-1]])) if len(arcs) else None
