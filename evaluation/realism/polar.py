"""From a picture of any layout to the polar picture that everything is measured on."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass

from ...factory.settings import STRICT
from ...factory.sonar.geometry import FanGeometry

Gray = npt.NDArray[np.float32]


@dataclass(frozen=True, config=STRICT)
class Grid:
    """The common polar grid: bins over the range window, beams over the sector.

    All widths along range and bearing are in cells of this grid: both sides must be on the same.
    """

    range_bins: Annotated[int, Field(ge=64, le=4096)] = 440
    beams: Annotated[int, Field(ge=32, le=2048)] = 128


def to_polar(picture: npt.NDArray[Any], geometry: FanGeometry, grid: Grid) -> Gray:
    """(H, W) grey values -> (range_bins, beams with data) float32, near range and left first.

    Inverse mapping: each cell of the grid looks up its place in the picture, bilinear.  Only whole
    cells within `geometry.data_fraction` are kept.
    """
    import cv2

    columns, rows = _lookup(geometry, grid, picture.shape[:2])
    gray = np.ascontiguousarray(picture, dtype=np.float32)
    return np.asarray(
        cv2.remap(gray, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )


@lru_cache(maxsize=16)
def _lookup(geometry: FanGeometry, grid: Grid, shape: tuple[int, int]) -> tuple[Gray, Gray]:
    """Column and row in the picture of each cell of the grid."""
    start, end = geometry.data_fraction
    first = math.ceil(round(start * grid.beams, 6))
    last = max(math.floor(round(end * grid.beams, 6)), first + 1)
    along = (np.arange(grid.range_bins) + 0.5)[:, None] / grid.range_bins
    across = (np.arange(first, last) + 0.5)[None, :] / grid.beams
    range_fraction = geometry.near_fraction + along * (1 - geometry.near_fraction)
    azimuth_rad = (across - 0.5) * geometry.sector_rad
    rows, columns = np.broadcast_arrays(
        *geometry.with_size(*shape).pixels(range_fraction, azimuth_rad)
    )
    return np.ascontiguousarray(columns, np.float32), np.ascontiguousarray(rows, np.float32)
