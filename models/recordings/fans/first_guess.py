"""A first guess of a fan's outline, from lines along the sides of the largest lit part."""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ....factory.common.array_types import Array, Bools, Float32s, Float64s
from .sector import AnchorRows, Outline

_THUMBNAIL_PX = 160  # longest side
_MIN_LIT_SHARE = 0.05  # of a pixel of the thumbnail that is not black
_MIN_LIT_PIXELS = 20
_DENSE_SHARE = 0.4  # of the usual share of lit pixels
_MIN_PART = 0.03  # of the thumbnail
_MIN_EDGE_ROWS = 6
_MIN_CONVERGENCE = 1e-3  # columns by which the edges come closer in a row
_EDGE_FITS = 4
_MIN_EDGE_SPREAD_PX = 0.7


class FirstGuess(NamedTuple):
    """An outline to start a fit from.

    anchors: the rows at which the outline states its edges.
    cell_px: pixels of the image per pixel of the thumbnail in which the outline was found.
    """

    outline: Outline
    anchors: AnchorRows
    cell_px: float


class _EdgeLine(NamedTuple):
    """An edge of the lit part: column = columns_per_row * row + first_column."""

    columns_per_row: float
    first_column: float

    def columns(self, rows: Float64s) -> Float64s:
        return np.asarray(np.polyval(self, rows))


class _Thumbnail(NamedTuple):
    """A smaller image.

    lit_share: (h, w), how much of each pixel is lit.
    rows_px, columns_px: height and width of its pixels, in pixels of the image.
    cell_px: by which the longer side was reduced.
    """

    lit_share: Float32s
    rows_px: float
    columns_px: float
    cell_px: float


def guess_outline(lit: Bools) -> FirstGuess | None:
    """Guess the outline of the lit pixels, (H, W); None where they form no sector."""
    thumbnail = _reduce(lit)
    part = _largest_dense_part(thumbnail.lit_share)
    if part is None:
        return None

    part_rows = np.flatnonzero(part.any(axis=1))
    left = _fit_left_edge(part_rows, part[part_rows].argmax(axis=1))
    mirrored_right = _fit_left_edge(part_rows, part[part_rows, ::-1].argmax(axis=1))
    if left is None or mirrored_right is None:
        return None
    if left.columns_per_row + mirrored_right.columns_per_row <= _MIN_CONVERGENCE:
        return None
    last_column = part.shape[1] - 1
    right = _EdgeLine(-mirrored_right.columns_per_row, last_column - mirrored_right.first_column)

    # The part begins and ends at the arcs in the sonar's column.
    apex_column = int(np.clip(_apex_column(left, right), 1, last_column - 1))
    rows_ahead = np.flatnonzero(part[:, apex_column - 1 : apex_column + 2].any(axis=1))
    if not len(rows_ahead):
        return None

    anchor_rows = np.array([part_rows[len(part_rows) // 4], part_rows[-1]], float)
    arc_rows = np.array([rows_ahead[0], rows_ahead[-1]])
    left_upper, left_lower = _to_image(left.columns(anchor_rows), thumbnail.columns_px)
    right_upper, right_lower = _to_image(right.columns(anchor_rows), thumbnail.columns_px)
    far_row, near_row = _to_image(arc_rows, thumbnail.rows_px)
    outline = Outline(
        left_upper=left_upper,
        left_lower=left_lower,
        right_upper=right_upper,
        right_lower=right_lower,
        far_row=far_row,
        near_row=near_row,
        log_squeeze=0.0,
    )
    anchors = AnchorRows(*_to_image(anchor_rows, thumbnail.rows_px))
    return FirstGuess(outline, anchors, thumbnail.cell_px)


def _reduce(lit: Bools) -> _Thumbnail:
    height, width = lit.shape
    cell_px = max(1, math.ceil(max(height, width) / _THUMBNAIL_PX))
    columns = math.ceil(width / cell_px)
    # A wide image is reduced less in its rows, by which the edges are fitted.
    row_scale = max(1, math.ceil(height / _THUMBNAIL_PX))
    rows = math.ceil(height / row_scale)
    lit_share = cv2.resize(lit.astype(np.float32), (columns, rows), interpolation=cv2.INTER_AREA)
    return _Thumbnail(
        lit_share=np.asarray(lit_share, np.float32),
        rows_px=height / rows,
        columns_px=width / columns,
        cell_px=float(cell_px),
    )


def _to_image(positions: Array, cell_px: float) -> list[float]:
    """Positions in the image of positions in the thumbnail; both count from a pixel's centre."""
    image_positions: list[float] = ((positions + 0.5) * cell_px - 0.5).tolist()
    return image_positions


def _largest_dense_part(lit_share: Float32s) -> Bools | None:
    """Mask of the largest area in which many pixels are lit; None where it is next to nothing.

    lit_share: (h, w), see `_Thumbnail`.
    """
    smooth_share = cv2.blur(lit_share, (3, 3))
    partly_lit = smooth_share[smooth_share > _MIN_LIT_SHARE]
    if partly_lit.size < _MIN_LIT_PIXELS:
        return None
    is_dense = (smooth_share > _DENSE_SHARE * np.median(partly_lit)).astype(np.uint8)
    closed = cv2.morphologyEx(is_dense, cv2.MORPH_CLOSE, np.ones((5, 5), np.uint8))
    label_count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    part = labels > 0
    if label_count > 1:
        largest = 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])  # label 0 is the ground
        part = labels == largest
    if part.mean() < _MIN_PART:
        return None
    return np.asarray(part)


def _fit_left_edge(
    part_rows: npt.NDArray[np.intp], first_columns: npt.NDArray[np.intp]
) -> _EdgeLine | None:
    """Fit a line to the left border of a part, from its leftmost row down; robust to outliers.

    first_columns: the first column of the part in each of its rows.
    None where fewer than `_MIN_EDGE_ROWS` rows are left.
    """
    corner = int(np.flatnonzero(first_columns <= first_columns.min()).max())
    rows = part_rows[corner + 1 : -1].astype(float)
    columns = first_columns[corner + 1 : -1].astype(float)
    if len(rows) < _MIN_EDGE_ROWS:
        return None
    weights = np.ones(len(rows))
    for _ in range(_EDGE_FITS):
        line = _EdgeLine(*np.polyfit(rows, columns, 1, w=weights))
        distances_px = np.abs(line.columns(rows) - columns)
        spread_px = max(_MIN_EDGE_SPREAD_PX, 1.5 * float(np.median(distances_px)))
        weights = 1 / (1 + (distances_px / spread_px) ** 2)
    return line


def _apex_column(left: _EdgeLine, right: _EdgeLine) -> float:
    """The column in which the edges meet, at the sonar."""
    convergence = left.columns_per_row - right.columns_per_row
    apex_row = (right.first_column - left.first_column) / convergence
    return float(np.polyval(left, apex_row))
