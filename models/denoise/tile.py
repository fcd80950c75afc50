"""Large pictures in overlapping tiles, blended without a seam."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

Maps = Mapping[str, npt.NDArray[np.float32]]
Work = Callable[[npt.NDArray[np.float32], Maps], npt.NDArray[np.float32]]


def starts(size: int, tile: int, overlap: int) -> list[int]:
    """First pixels of tiles that cover `size`, evenly spread, each sharing >= `overlap` pixels."""
    if size <= tile:
        return [0]
    count = math.ceil((size - overlap) / (tile - overlap))
    return [round(number * (size - tile) / (count - 1)) for number in range(count)]


def tiled(
    work: Work, image: npt.NDArray[np.float32], maps: Maps, tile: int, overlap: int
) -> npt.NDArray[np.float32]:
    """`work` on tiles of at most `tile` pixels a side, put together again.

    image, and each of maps: (H, W).  Where tiles overlap, their weights rise and fall linearly over
    the `overlap` nearest the edge.  A picture that fits one tile goes through as it is.
    Raises ValueError unless 0 <= overlap <= tile / 2.
    """
    height, width = image.shape
    if not 0 <= overlap <= tile // 2:
        raise ValueError(f"overlap {overlap} must be at most half of the tile {tile}")
    if height <= tile and width <= tile:
        return work(image, maps)
    total = np.zeros(image.shape, np.float64)
    weights = np.zeros(image.shape, np.float64)
    for top in starts(height, tile, overlap):
        for left in starts(width, tile, overlap):
            window = np.s_[top : top + tile, left : left + tile]
            part = work(image[window], {name: values[window] for name, values in maps.items()})
            weight = np.outer(_ramp(part.shape[0], overlap), _ramp(part.shape[1], overlap))
            total[window] += weight * part
            weights[window] += weight
    return (total / weights).astype(np.float32)


def _ramp(size: int, overlap: int) -> npt.NDArray[np.float64]:
    """Rises from the edge over `overlap` pixels, never quite 0."""
    edge = np.minimum(np.arange(size), np.arange(size)[::-1]) + 1.0
    return np.minimum(edge / (overlap + 1), 1.0)
