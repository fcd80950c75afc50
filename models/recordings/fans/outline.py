"""The outline of a sector by the parameters that a fit varies: where its edges and arcs lie."""

from __future__ import annotations

import math
from typing import NamedTuple

from .sector import Sector

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
