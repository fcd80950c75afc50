"""A sector in an image, and the outline by which a fit varies it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ....factory.common.array_types import Float64s, Int64s, UInt8s
from ....factory.dataset.fan_geometry import FanGeometry

_MIN_HALF_ANGLE_DEG = 2.0
_MAX_HALF_ANGLE_DEG = 88.0
# Largest squeeze, or its inverse.  A fit may go farther (`outline.MAX_FITTED_SQUEEZE`): one that
# runs into its limit has found no fan.
_MAX_PLAUSIBLE_SQUEEZE = 1.95


class Sector(NamedTuple):
    """A sector with far range on top, in pixels of the image.

    apex_x, apex_y: column and row of the sonar.
    far_px, near_px: radii of the far and the near arc, along y.
    left_tangent, right_tangent: tangents of the bearings of both edges, positive to the right.
    squeeze: pixels along x that are as long as one pixel along y.
    """

    apex_x: float
    apex_y: float
    far_px: float
    near_px: float
    left_tangent: float
    right_tangent: float
    squeeze: float

    def is_plausible(self) -> bool:
        """Whether a sonar may have such a sector, and a screen such pixels."""
        half_angles_deg = (
            math.degrees(-math.atan(self.left_tangent)),
            math.degrees(math.atan(self.right_tangent)),
        )
        if min(half_angles_deg) < _MIN_HALF_ANGLE_DEG:
            return False
        if max(half_angles_deg) > _MAX_HALF_ANGLE_DEG:
            return False
        return abs(math.log(self.squeeze)) <= math.log(_MAX_PLAUSIBLE_SQUEEZE)

    def mask(self, height: int, width: int) -> UInt8s:
        """(H, W), 1 where the centre of a pixel lies in the sector, 0 elsewhere."""
        first, last = row_spans(self, np.arange(width))
        rows = np.arange(height)[:, None]
        return np.asarray((first <= rows) & (rows <= last), np.uint8)

    def to_geometry(self) -> FanGeometry:
        """The fan that has its data in this sector; the device's sector is symmetric."""
        left_rad = math.atan(self.left_tangent)
        right_rad = math.atan(self.right_tangent)
        symmetric_fan = FanGeometry.fan(
            2 * max(-left_rad, right_rad),
            apex_x_px=self.apex_x,
            apex_y_px=self.apex_y,
            near_px=self.near_px,
            far_px=self.far_px,
            x_scale=self.squeeze,
        )
        return replace(symmetric_fan, azimuth_min_rad=left_rad, azimuth_max_rad=right_rad)


def row_spans(sector: Sector, columns: Int64s) -> Float64s:
    """(2, n) first and last rows, with fractions, in which columns of an image meet a sector.

    A span begins at the far arc and ends at the near arc or at an edge, whichever comes first.
    Beside the sector the last row is above the first.
    columns: (n,).  Fields of several sectors, (S, 1) each, give (2, S, n).
    """
    across = (columns - sector.apex_x) / sector.squeeze
    # Distances ahead of the apex, along y, of both arcs.
    squares = across * across
    ahead = np.empty((2, *across.shape))
    np.subtract(sector.far_px * sector.far_px, squares, out=ahead[0])
    np.subtract(sector.near_px * sector.near_px, squares, out=ahead[1])
    np.maximum(ahead, 0.0, out=ahead)
    np.sqrt(ahead, out=ahead)
    # An edge lies ahead in columns of its own side, and behind the apex in the others.
    edge_ahead = np.maximum(across / sector.left_tangent, across / sector.right_tangent)
    np.maximum(ahead[1], edge_ahead, out=ahead[1])
    return np.asarray(np.subtract(sector.apex_y, ahead, out=ahead))


MAX_FITTED_SQUEEZE = 2.0
"""Largest squeeze, or its inverse, that a fit may reach."""
_MIN_COLUMNS_PER_ROW = 1e-3  # slope of an edge towards the sonar


class AnchorRows(NamedTuple):
    """The two rows of the image at which an outline says where its edges are."""

    upper: float
    lower: float


class Outline(NamedTuple):
    """Columns of both edges in the anchor rows, rows of both arcs, and the squeeze.

    Unlike apex and bearings, these are lengths that the image shows, and hardly depend on each
    other: a fit can vary one after the other.

    left_upper, left_lower, right_upper, right_lower: columns of the left and the right edge in the
        upper and the lower anchor row.
    far_row, near_row: rows of the far and the near arc, straight ahead of the sonar.
    log_squeeze: natural logarithm of `Sector.squeeze`.
    """

    left_upper: float
    left_lower: float
    right_upper: float
    right_lower: float
    far_row: float
    near_row: float
    log_squeeze: float

    def to_sector(self, anchors: AnchorRows) -> Sector | None:
        """The sector inside; None where the outline encloses none.

        That is where the edges do not meet below, the arcs are not in order, or the squeeze is
        beyond `MAX_FITTED_SQUEEZE`.  Slow with NumPy's scalars: the fields must be plain floats.
        """
        anchor_distance = anchors.lower - anchors.upper
        left_slope = (self.left_lower - self.left_upper) / anchor_distance
        right_slope = (self.right_lower - self.right_upper) / anchor_distance
        if left_slope <= _MIN_COLUMNS_PER_ROW or right_slope >= -_MIN_COLUMNS_PER_ROW:
            return None
        squeeze = math.exp(self.log_squeeze)
        if not 1 / MAX_FITTED_SQUEEZE < squeeze < MAX_FITTED_SQUEEZE:
            return None

        # The edges meet at the sonar.
        upper_width = self.right_upper - self.left_upper
        apex_y = anchors.upper + upper_width / (left_slope - right_slope)
        apex_x = self.left_upper + left_slope * (apex_y - anchors.upper)
        far_px = apex_y - self.far_row
        near_px = max(apex_y - self.near_row, 0.0)
        if far_px <= near_px:
            return None
        return Sector(
            apex_x=apex_x,
            apex_y=apex_y,
            far_px=far_px,
            near_px=near_px,
            left_tangent=-left_slope / squeeze,
            right_tangent=-right_slope / squeeze,
            squeeze=squeeze,
        )
