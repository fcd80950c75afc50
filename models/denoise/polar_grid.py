"""Fan pictures resampled to range by bearing and back, in NumPy: as `models.networks.sonarnet`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Plane = npt.NDArray[np.float32]
Positions = tuple[Plane, Plane]
_SMALLEST = np.float32(1e-6)


@dataclass(frozen=True, eq=False)
class PolarGrid:
    """Rows and columns, in pixels, of the cells in the fan, and of the pixels in the grid.

    range_fraction, azimuth_rad: (H, W) of the cells, near range first.
    """

    in_fan: Positions
    in_grid: Positions
    range_fraction: Plane
    azimuth_rad: Plane

    @classmethod
    def of(cls, maps: Mapping[str, Plane]) -> PolarGrid | None:
        """The grid for a fan; None for pictures that are polar already, or too small to tell."""
        radius, azimuth = maps["range_fraction"], maps["azimuth_rad"]
        height, width = radius.shape
        if min(height, width) < 2 or (radius == radius[:, :1]).all():
            return None
        inside = maps["sector"] > 0 if "sector" in maps else np.ones(radius.shape, bool)
        if not inside.any():
            inside = np.ones_like(inside)
        right, ahead = radius * np.sin(azimuth), radius * np.cos(azimuth)
        first_right, first_ahead = right[:, 0].mean(), ahead[0].mean()
        right_step = (right[:, -1].mean() - first_right) / np.float32(width - 1)
        ahead_step = (ahead[-1].mean() - first_ahead) / np.float32(height - 1)
        near, far = _extent(radius[inside])
        left, right_end = _extent(azimuth[inside])
        down = (np.arange(height, dtype=np.float32) + np.float32(0.5)) / np.float32(height)
        across = (np.arange(width, dtype=np.float32) + np.float32(0.5)) / np.float32(width)
        cell_range = np.broadcast_to((near + (far - near) * down)[:, None], radius.shape)
        cell_azimuth = np.broadcast_to(left + (right_end - left) * across, radius.shape)
        row = (cell_range * np.cos(cell_azimuth) - first_ahead) / ahead_step
        column = (cell_range * np.sin(cell_azimuth) - first_right) / right_step
        in_fan = [
            _rounded((2 * place + 1) / np.float32(side) - 1, side)
            for place, side in ((row, height), (column, width))
        ]
        in_grid = [
            _rounded(2 * (values - least) / (most - least) - 1, side)
            for values, least, most, side in (
                (radius, near, far, height),
                (azimuth, left, right_end, width),
            )
        ]
        return cls((in_fan[0], in_fan[1]), (in_grid[0], in_grid[1]), cell_range, cell_azimuth)

    def polar(self, picture: Plane) -> Plane:
        """A fan picture (H, W) on the grid, bilinear."""
        return _sampled(picture, self.in_fan)

    def fan(self, cells: Plane) -> Plane:
        """What is on the grid as a fan picture, bilinear; repeated outside the grid."""
        return _sampled(cells, self.in_grid)


def _extent(values: Plane) -> tuple[np.float32, np.float32]:
    least = values.min()
    return least, max(values.max(), least + _SMALLEST)


def _rounded(position: Plane, side: int) -> Plane:
    """Pixels from a position of -1 to 1 over a side, rounded as torch's `grid_sample` does."""
    return ((position + 1) * np.float32(side) - 1) / 2


def _sampled(picture: Plane, at: Positions) -> Plane:
    height, width = picture.shape
    row, column = (
        np.clip(place, 0, side - 1) for place, side in zip(at, picture.shape, strict=True)
    )
    top, first = row.astype(np.int64), column.astype(np.int64)
    lower, right = row - top, column - first
    bottom, last = np.minimum(top + 1, height - 1), np.minimum(first + 1, width - 1)
    above = picture[top, first] * (1 - right) + picture[top, last] * right
    below = picture[bottom, first] * (1 - right) + picture[bottom, last] * right
    return np.asarray(above * (1 - lower) + below * lower, np.float32)
