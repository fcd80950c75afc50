"""From a picture of any layout to the polar picture that everything is measured on."""

from __future__ import annotations

import math
from dataclasses import dataclass as plain_dataclass
from functools import lru_cache
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass

from simnfnd.factory.settings import STRICT

Gray = npt.NDArray[np.float32]


@dataclass(frozen=True, config=STRICT)
class Grid:
    """The common polar grid: bins over the range window, beams over the sector.

    All widths along range and bearing are told in its cells, so both sides must be on the same.
    """

    range_bins: Annotated[int, Field(ge=64, le=4096)] = 440
    beams: Annotated[int, Field(ge=32, le=2048)] = 128


@plain_dataclass(frozen=True)
class Geometry:
    """Where range and bearing are in a picture.

    layout: fan (far range on top, apex at or below the lower edge) or polar (a row a range, near
        range first; a column a bearing, left to right; the picture is the whole sector).
    apex_x_px, apex_y_px: centre of the arcs, in pixels from the centre of the top left pixel.
    near_px, far_px: radii of the sector along y.  hfov_deg: its true width.
    x_scale: width of a pixel along x over its height; 0.8 where x is squeezed to 0.8 of y.
    range_min_m, range_max_m: what near and far are in metres, None where nobody knows.
    seen: first and last bearing with data, as fractions of the sector from the left.
    """

    layout: Literal["fan", "polar"]
    hfov_deg: float
    apex_x_px: float = 0.0
    apex_y_px: float = 0.0
    near_px: float = 0.0
    far_px: float = 0.0
    x_scale: float = 1.0
    range_min_m: float | None = None
    range_max_m: float | None = None
    seen: tuple[float, float] = (0.0, 1.0)

    @property
    def span_m(self) -> float | None:
        """Length of the range window in metres, None where nobody knows."""
        if self.range_min_m is None or self.range_max_m is None:
            return None
        return self.range_max_m - self.range_min_m


def to_polar(picture: npt.NDArray[Any], geometry: Geometry, grid: Grid) -> Gray:
    """(H, W) grey values -> (range_bins, beams seen) float32, near range first, left bearing first.

    Inverse mapping: each cell of the grid looks up its place in the picture, bilinear.  Only whole
    cells within `geometry.seen` are kept.
    """
    import cv2

    columns, rows = _table(geometry, grid, picture.shape[:2])
    gray = np.ascontiguousarray(picture, dtype=np.float32)
    return np.asarray(
        cv2.remap(gray, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )


def sector_mask(geometry: Geometry, shape: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """(H, W) bool: the pixels of a fan picture whose centres lie in the sector."""
    ahead = geometry.apex_y_px - np.arange(shape[0], dtype=np.float64)[:, None]
    right = (np.arange(shape[1], dtype=np.float64)[None, :] - geometry.apex_x_px) / geometry.x_scale
    radius = np.hypot(ahead, right)
    inside = (radius >= geometry.near_px) & (radius <= geometry.far_px)
    return np.asarray(
        inside & (np.abs(np.arctan2(right, ahead)) <= math.radians(geometry.hfov_deg) / 2)
    )


@lru_cache(maxsize=16)
def _table(geometry: Geometry, grid: Grid, shape: tuple[int, int]) -> tuple[Gray, Gray]:
    """Column and row in the picture of each cell of the grid."""
    first = math.ceil(round(geometry.seen[0] * grid.beams, 6))
    last = max(math.floor(round(geometry.seen[1] * grid.beams, 6)), first + 1)
    fraction = (np.arange(grid.range_bins) + 0.5)[:, None] / grid.range_bins
    bearing = (np.arange(first, last) + 0.5)[None, :] / grid.beams
    if geometry.layout == "polar":
        rows = np.broadcast_to(fraction * shape[0] - 0.5, (grid.range_bins, last - first))
        columns = np.broadcast_to(bearing * shape[1] - 0.5, rows.shape)
    else:
        radius = geometry.near_px + fraction * (geometry.far_px - geometry.near_px)
        azimuth_rad = (bearing - 0.5) * math.radians(geometry.hfov_deg)
        columns = geometry.apex_x_px + geometry.x_scale * radius * np.sin(azimuth_rad)
        rows = geometry.apex_y_px - radius * np.cos(azimuth_rad)
    return np.ascontiguousarray(columns, np.float32), np.ascontiguousarray(rows, np.float32)
