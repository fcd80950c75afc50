"""The polar grid of a fan image, in NumPy, as `models.networks.polar_grid` computes it in torch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Float32s

Maps = Mapping[str, Float32s]
"""Planes of an image by the names of `models.networks`, (H, W) each."""
Positions = Sequence[Float32s]
"""Rows and columns of places in an image, pixels."""
_SMALLEST = np.float32(1e-6)


class FanCells(NamedTuple):
    """Cells of range by bearing, near range first, as many as a fan image has pixels.

    cells_in_fan: rows and columns, (H, W) each, of the cells in the fan image, pixels.
    pixels_in_grid: rows and columns, (H, W) each, of the fan image's pixels in the grid, cells.
    cells: `range_fraction` and `azimuth_rad` of the cells, (H, W) each.
    """

    cells_in_fan: Positions
    pixels_in_grid: Positions
    cells: Maps


def polar_grid(maps: Maps) -> FanCells | None:
    """Return the polar grid of a fan image, in NumPy, as `models.networks.polar_grid` computes it.

    None for images that are polar already, or too small to tell.
    """
    radius = maps["range_fraction"]
    azimuth = maps["azimuth_rad"]
    height, width = radius.shape
    if min(height, width) < 2 or (radius == radius[:, :1]).all():
        return None
    inside = maps["sector"] > 0 if "sector" in maps else np.ones(radius.shape, bool)
    if not inside.any():
        inside = np.ones_like(inside)

    # Where the pixels lie: right of the sonar and ahead of it, as shares of the largest range.
    right = radius * np.sin(azimuth)
    ahead = radius * np.cos(azimuth)
    first_right = right[:, 0].mean()
    first_ahead = ahead[0].mean()
    right_step = (right[:, -1].mean() - first_right) / np.float32(width - 1)
    ahead_step = (ahead[-1].mean() - first_ahead) / np.float32(height - 1)

    # Range and bearing of the centres of cells.
    near, far = _extent(radius[inside])
    left, right_end = _extent(azimuth[inside])
    down = (np.arange(height, dtype=np.float32) + np.float32(0.5)) / np.float32(height)
    across = (np.arange(width, dtype=np.float32) + np.float32(0.5)) / np.float32(width)
    cell_range = np.broadcast_to((near + (far - near) * down)[:, None], radius.shape)
    cell_azimuth = np.broadcast_to(left + (right_end - left) * across, radius.shape)

    # Positions from -1 to 1 over a side, as torch's `grid_sample` has them.
    row = (cell_range * np.cos(cell_azimuth) - first_ahead) / ahead_step
    column = (cell_range * np.sin(cell_azimuth) - first_right) / right_step
    cells_in_fan = [
        (2 * row + 1) / np.float32(height) - 1,
        (2 * column + 1) / np.float32(width) - 1,
    ]
    pixels_in_grid = [
        2 * (radius - near) / (far - near) - 1,
        2 * (azimuth - left) / (right_end - left) - 1,
    ]
    return FanCells(
        _in_pixels(cells_in_fan, radius.shape),
        _in_pixels(pixels_in_grid, radius.shape),
        {"range_fraction": cell_range, "azimuth_rad": cell_azimuth},
    )


def _in_pixels(positions: Positions, shape: tuple[int, ...]) -> list[Float32s]:
    """Turn positions from -1 to 1 over a side into pixels; rounds as `grid_sample` does."""
    return [
        ((position + 1) * np.float32(side) - 1) / 2
        for position, side in zip(positions, shape, strict=True)
    ]


def _extent(values: Float32s) -> tuple[np.float32, np.float32]:
    least = values.min()
    return least, max(values.max(), least + _SMALLEST)


def sampled(image: Float32s, positions: Positions) -> Float32s:
    """Interpolate an image at rows and columns in pixels, bilinear; its border is repeated."""
    height, width = image.shape
    row = np.clip(positions[0], 0, height - 1)
    column = np.clip(positions[1], 0, width - 1)
    top = row.astype(np.int64)
    left = column.astype(np.int64)
    lower_share = row - top
    right_share = column - left
    bottom = np.minimum(top + 1, height - 1)
    right = np.minimum(left + 1, width - 1)
    above = image[top, left] * (1 - right_share) + image[top, right] * right_share
    below = image[bottom, left] * (1 - right_share) + image[bottom, right] * right_share
    return np.asarray(above * (1 - lower_share) + below * lower_share, np.float32)
