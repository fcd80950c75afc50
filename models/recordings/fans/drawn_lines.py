"""Fans whose outline is drawn in white lines, as on chart plotters, however dark their inside."""

from __future__ import annotations

import math
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np

from ....factory.common.array_types import UInt8s
from ....factory.dataset.fan_geometry import FanGeometry
from .lit_pixels import sample_nearest

_WHITE = 200  # of 255
_MAX_LINE_SHARE = 0.05  # of the image: more thin bright pixels are speckle
_MIN_SLOPE_DEG = 3.0  # between a side line and the rows of the image
_MAX_SLOPE_DEG = 75.0
_MAX_ASYMMETRY_DEG = 1.0  # by which both slopes may differ
_LONGEST_LINES = 8  # of each side, that are tried
_MIN_ARC_WHITE = 0.35  # share of an arc within the image that must be white
_MIN_ARC_SAMPLES = 180  # of 700 of an arc, that must lie within the image


class _Line(NamedTuple):
    """A white line: its length, its slope, positive downwards, and its left end, pixels."""

    length_px: float
    slope_deg: float
    left_x: float
    left_y: float

    @property
    def slope(self) -> float:
        """Rows per column, positive downwards."""
        return math.tan(math.radians(self.slope_deg))


class _SideLines(NamedTuple):
    """Lines that may be the left or the right side of a fan, the longest first."""

    left: list[_Line]
    right: list[_Line]


class _Apex(NamedTuple):
    """Column and row of the sonar."""

    x: float
    y: float


def find_drawn_fan(grey: UInt8s) -> FanGeometry | None:
    """The fan bounded by two white side lines and the outermost arc."""
    lines = _thin_white_lines(grey)
    if lines.mean() > _MAX_LINE_SHARE:
        return None
    sides = _find_side_lines(lines)
    for left, right in product(sides.left[:_LONGEST_LINES], sides.right[:_LONGEST_LINES]):
        fan = _fan_of_sides(lines, left, right)
        if fan is not None:
            return fan
    return None


def _thin_white_lines(grey: UInt8s) -> UInt8s:
    """(H, W), 1 on thin white lines and 0 elsewhere."""
    is_white = (grey >= _WHITE).astype(np.uint8)
    # Opening removes thin lines alone, so they are the difference.
    wide_areas = cv2.morphologyEx(is_white, cv2.MORPH_OPEN, np.ones((9, 9), np.uint8))
    return np.asarray(is_white - wide_areas, np.uint8)


def _find_side_lines(lines: UInt8s) -> _SideLines:
    # A fifth of the width or longer; between the sonar and the line there may be 12 pixels.
    min_length_px = 0.2 * lines.shape[1]
    segments = cv2.HoughLinesP(lines, 1, math.radians(0.25), 100, None, min_length_px, 12.0)
    sides = _SideLines([], [])
    if segments is None:
        return sides
    for left_x, left_y, right_x, right_y in segments.reshape(-1, 4).astype(float):
        run = right_x - left_x
        drop = right_y - left_y
        slope_deg = math.degrees(math.atan2(drop, run))
        if _MIN_SLOPE_DEG <= abs(slope_deg) <= _MAX_SLOPE_DEG:
            side = sides.left if slope_deg >= 0 else sides.right
            side.append(_Line(math.hypot(run, drop), slope_deg, left_x, left_y))
    sides.left.sort(reverse=True)
    sides.right.sort(reverse=True)
    return sides


def _fan_of_sides(lines: UInt8s, left: _Line, right: _Line) -> FanGeometry | None:
    """The fan between two side lines; None unless they meet low in the image, below an arc."""
    if abs(left.slope_deg + right.slope_deg) > _MAX_ASYMMETRY_DEG:
        return None
    height, width = lines.shape
    apex = _cross_lines(left, right)
    if not (0 < apex.x < width and height / 2 < apex.y < height):
        return None
    half_angle_rad = math.pi / 2 - math.radians(left.slope_deg - right.slope_deg) / 2
    far_px = _find_outermost_arc(lines, apex, half_angle_rad)
    if far_px is None:
        return None
    return FanGeometry.fan(
        2 * half_angle_rad, apex_x_px=apex.x, apex_y_px=apex.y, near_px=0.0, far_px=far_px
    )


def _cross_lines(left: _Line, right: _Line) -> _Apex:
    """Where the side lines meet: at the sonar."""
    row_distance = right.left_y - left.left_y + left.slope * left.left_x
    x = (row_distance - right.slope * right.left_x) / (left.slope - right.slope)
    return _Apex(x, left.left_y + left.slope * (x - left.left_x))


def _find_outermost_arc(lines: UInt8s, apex: _Apex, half_angle_rad: float) -> float | None:
    """Radius of the outermost drawn arc about the sonar, pixels; None without any."""
    height, width = lines.shape
    # Without the ends of the arc, where it meets the side lines.
    bearings_rad = np.linspace(-half_angle_rad, half_angle_rad, 720)[10:-10]
    radii_px = np.arange(height / 4, math.hypot(width, height))[:, None]
    rows = apex.y - radii_px * np.cos(bearings_rad)
    columns = apex.x + radii_px * np.sin(bearings_rad)
    widened = cv2.dilate(lines, np.ones((3, 3), np.uint8))
    samples = sample_nearest(widened, rows, columns)

    sample_counts = samples.is_inside.sum(axis=1)
    white_shares = samples.values.sum(axis=1) / np.maximum(sample_counts, 1)
    is_arc = (sample_counts >= _MIN_ARC_SAMPLES) & (white_shares >= _MIN_ARC_WHITE)
    arcs = np.flatnonzero(is_arc)
    return float(radii_px[arcs[-1], 0]) if len(arcs) else None
