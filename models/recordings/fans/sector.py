"""A sector in an image: the rows that it covers in each column, its mask, and its plausibility."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ....factory.common.array_types import Float64s, UInt8s
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
        columns = np.arange(width, dtype=np.float64)
        (first_row,), (last_row,) = row_spans([self], columns)
        row = np.arange(height)[:, None]
        return np.asarray((row >= first_row) & (row <= last_row), np.uint8)

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


# Far and near, left and right in a table of sectors.
_RADII = slice(Sector._fields.index("far_px"), Sector._fields.index("near_px") + 1)
_TANGENTS = slice(Sector._fields.index("left_tangent"), Sector._fields.index("right_tangent") + 1)


def row_spans(sectors: Sequence[Sector], columns: Float64s) -> Float64s:
    """(2, N, W) first and last row, with fractions, of N sectors in W columns of the image.

    A column meets a sector in one span of rows.  It begins at the far arc and ends at the near arc
    or at an edge, whichever comes first.  Beside the sector the last row is above the first.
    """
    table = np.array(sectors, np.float64).reshape(-1, len(Sector._fields))
    # Each parameter is (N, 1), against columns of (W,).
    apex_x, apex_y, *_, squeeze = table.T[..., None]
    radii_px = table.T[_RADII, :, None]
    tangents = table.T[_TANGENTS, :, None]
    across = (columns - apex_x) / squeeze

    # Distances ahead of the apex, along y: of the far and of the near arc.
    limits_ahead = np.sqrt(np.maximum(np.square(radii_px) - across * across, 0.0))
    # An edge lies ahead in columns of its own side, and behind the apex in the others.
    edges_ahead = (across / tangents).max(axis=0)
    limits_ahead[1] = np.maximum(limits_ahead[1], edges_ahead)
    return np.asarray(apex_y - limits_ahead)
