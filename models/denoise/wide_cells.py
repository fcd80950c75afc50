"""Fan images whose cells are wider than a pixel, for a network that learned from narrow ones.

A sonar of 256 beams fills an image of 512x512 pixels with cells of two pixels.  On a polar grid
with a place for every pixel (`polar`) its grain is twice as wide as any that the network learned
from.  Such an image is given to the network on a grid with one place for each cell, the mean of
what the finer grid has there.  What comes back is enlarged to the fan's pixels.

The width of cells is measured in the image: a display may enlarge them, and files rarely tell.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from ...factory.common.array_types import Float32s, Float64s
from .polar import FanCells, Maps, polar_grid, sampled

_LEAST_SIDE = 192
"""Places along a side of a coarser grid: networks have seen few of fewer."""
_WIDE = 1.3
"""Width in pixels from which on cells are wide; grain of one pixel measures 1.0 to 1.25."""
_LAG_OF_PIXELS = 2.0
"""Lag at which second differences are most unlike where cells are one pixel wide."""
_MOST_LAGS = 12
_AROUND = 9  # places along a side of the surroundings that grain is measured against
_DARK = 0.02  # mean grey value of surroundings without echoes
_LEAST_POWER = 1e-6
_LEAST_GREY = np.float32(1e-4)


def by_cells(grey: Float32s, maps: Maps, denoise: Callable[[Float32s, Maps], Float32s]) -> Float32s:
    """`denoise` of an image, (H, W) in 0..1, on a grid of its cells where these are wide.

    maps: planes of the image, (H, W), among them `range_fraction` and `azimuth_rad` where known.
    """
    grid = polar_grid(maps) if "azimuth_rad" in maps else None
    if grid is None:
        return denoise(grey, maps)
    polar_grey = sampled(grey, grid.cells_in_fan)
    width = cell_width(polar_grey)
    rows, columns = (max(round(side / width), _LEAST_SIDE) for side in grey.shape)
    if width < _WIDE or rows >= grey.shape[0] or columns >= grey.shape[1]:
        return denoise(grey, maps)
    cell_means = _mean_of_cells(polar_grey, rows, columns)
    denoised = denoise(cell_means, _maps_of_cells(maps, grid, rows, columns))

    shares = (rows / grey.shape[0], columns / grey.shape[1])
    pixels_in_cells = [
        (position + 0.5) * np.float32(share) - 0.5
        for position, share in zip(grid.pixels_in_grid, shares, strict=True)
    ]
    denoised_pixels = sampled(denoised, pixels_in_cells)
    noisy_pixels = sampled(cell_means, pixels_in_cells)
    # Detail within a cell stays in proportion to the brightness that the cell keeps.
    kept_share = np.clip(denoised_pixels / np.maximum(noisy_pixels, _LEAST_GREY), 0, 1)
    restored = denoised_pixels + kept_share * (grey - noisy_pixels)
    if "sector" in maps:
        restored = np.where(maps["sector"] > 0, restored, grey)
    return np.asarray(np.clip(restored, 0, 1), np.float32)


def _mean_of_cells(plane: Float32s, rows: int, columns: int) -> Float32s:
    """(rows, columns) means of a finer polar grid."""
    return np.asarray(cv2.resize(plane, (columns, rows), interpolation=cv2.INTER_AREA))


def _maps_of_cells(maps: Maps, grid: FanCells, rows: int, columns: int) -> dict[str, Float32s]:
    """The maps of a grid with one place for each cell, (rows, columns) each."""
    range_fraction = _mean_of_cells(grid.cells["range_fraction"], rows, columns)
    azimuth_rad = _mean_of_cells(grid.cells["azimuth_rad"], rows, columns)
    cell_maps = {
        # Exactly equal ranges along a row tell the network that this is no fan.
        "range_fraction": np.repeat(range_fraction[:, :1], columns, axis=1),
        "azimuth_rad": np.repeat(azimuth_rad[:1], rows, axis=0),
    }
    if "sector" in maps:
        sector = _mean_of_cells(sampled(maps["sector"], grid.cells_in_fan), rows, columns)
        cell_maps["sector"] = (sector > 0.5).astype(np.float32)
    return cell_maps


def cell_width(grid_values: Float32s) -> float:
    """Width of a sonar's cells in places of a polar grid, (H, W), from its far half; 1 or more.

    Grain that is interpolated bends where its cells meet, and is nearly straight between.  Its
    second differences are most unlike one another at a distance in proportion to a cell's width: at
    two places where cells of the paper's noise are one pixel wide (docs/research/paper-noise.md).
    """
    # Near the sonar, many places of the grid lie in one pixel of the fan.
    far = grid_values[grid_values.shape[0] // 2 :]
    similarity = (_bend_similarity(far) + _bend_similarity(np.ascontiguousarray(far.T))) / 2
    lag = int(np.argmin(similarity))
    if similarity[lag] >= 0 or not 0 < lag < len(similarity) - 1:
        return 1.0
    before, least, after = similarity[lag - 1 : lag + 2]
    # The vertex of a parabola through the three; lags begin at 1.
    vertex = lag + 1 + (before - after) / (2 * (before - 2 * least + after))
    return max(1.0, float(vertex) / _LAG_OF_PIXELS)


def _bend_similarity(lines: Float32s) -> Float64s:
    """Autocorrelation of second differences along columns at lags 1 to `_MOST_LAGS`.

    Zeros where the lines are dark, or without grain.
    """
    bend = lines[:-2] + lines[2:] - 2 * lines[1:-1]
    power = cv2.blur(bend * bend, (_AROUND, _AROUND))
    lit = cv2.blur(lines, (_AROUND, _AROUND))[1:-1] > _DARK
    # Each place counts alike, however bright: echoes must not outweigh grain.
    bend = np.where(lit, bend / np.sqrt(np.maximum(power, _LEAST_POWER)), 0)
    total = float(np.einsum("ij,ij->", bend, bend))
    if total <= 0:
        return np.zeros(_MOST_LAGS)
    products = [
        float(np.einsum("ij,ij->", bend[lag:], bend[:-lag])) for lag in range(1, _MOST_LAGS + 1)
    ]
    return np.array(products) / total
