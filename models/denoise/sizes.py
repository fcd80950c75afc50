"""Large pictures in overlapping tiles, and pictures with wide grain at half their size first.

A display that enlarges makes grain wider than any that a network has learned from, which then takes
it for ground.  At half the size the grain is as it should be.  The change found there is enlarged
and added, and the picture with less noise denoised as it is, which finds edges and what is left.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

import cv2
import numpy as np
import numpy.typing as npt

Grey = npt.NDArray[np.float32]
Maps = Mapping[str, Grey]
Work = Callable[[Grey, Maps], Grey]

_AROUND_PX = 9  # side of the mean that grain is measured against
_RAMP = 0.05  # of the correlation: from nothing to the whole change of the smaller picture
_LEAST_LIT, _LEAST_SIDE = 2000, 96
"""Pixels with neighbours to measure grain, and side of a picture that may still be halved."""


def by_scales(grey: Grey, maps: Maps, denoise: Callable[[Grey, Maps], Grey], widest: float) -> Grey:
    """`denoise` of a picture, (H, W) in 0..1, first at smaller sizes while its grain is wide.

    maps: planes of the picture for `denoise`, (H, W) or (H, W, more), some perhaps `sector`.
    widest: correlation of the grain of neighbouring pixels from which on it is wide; 1: never.
    """
    part = np.float32(0)
    if widest < 1 and min(grey.shape) >= 2 * _LEAST_SIDE:
        part = np.float32(np.clip((correlation(grey) - widest) / _RAMP, 0, 1))
    if part == 0:
        return denoise(grey, maps)
    small = halved(grey)
    below = {name: halved(plane) for name, plane in maps.items()}
    if "sector" in below:
        below["sector"] = (below["sector"] > 0.5).astype(np.float32)
    change = by_scales(small, below, denoise, widest) - small
    height, width = grey.shape
    size = 2 * change.shape[1], 2 * change.shape[0]
    enlarged = cv2.resize(change, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    if "sector" in maps:
        enlarged = enlarged * (maps["sector"] > 0)
    return denoise(np.clip(grey + part * enlarged, 0, 1).astype(np.float32), maps)


def correlation(grey: Grey) -> float:
    """Of the grain of pixels that are neighbours along rows or columns, the lesser of both.

    0 where too few pixels are lit to tell, or where there is no grain.
    """
    lit = cv2.erode((grey > 0).astype(np.uint8), np.ones((3, 3), np.uint8))
    if np.count_nonzero(lit) < _LEAST_LIT:
        return 0.0
    grain = (grey - cv2.blur(grey, (_AROUND_PX, _AROUND_PX))) * lit
    power = float(np.einsum("ij,ij->", grain, grain))
    if power <= 0:
        return 0.0
    down = float(np.einsum("ij,ij->", grain[1:], grain[:-1]))
    across = float(np.einsum("ij,ij->", grain[:, 1:], grain[:, :-1]))
    return min(down, across) / power


def halved(plane: Grey) -> Grey:
    """(H, W) or (H, W, more) -> half of the size, means of 2 x 2; odd sides end in their last."""
    odd = [(0, side % 2) for side in plane.shape[:2]] + [(0, 0)] * (plane.ndim - 2)
    even = np.pad(plane, odd, mode="edge") if plane.shape[0] % 2 or plane.shape[1] % 2 else plane
    return np.asarray(
        (even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / np.float32(4),
        np.float32,
    )


def starts(size: int, tile: int, overlap: int) -> list[int]:
    """First pixels of tiles that cover `size`, evenly spread, each sharing >= `overlap` pixels."""
    if size <= tile:
        return [0]
    count = math.ceil((size - overlap) / (tile - overlap))
    return [round(number * (size - tile) / (count - 1)) for number in range(count)]


def tiled(work: Work, image: Grey, maps: Maps, tile: int, overlap: int) -> Grey:
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
