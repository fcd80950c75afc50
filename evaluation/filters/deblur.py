"""Deconvolution of the blur along range."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt
from scipy import ndimage

from .base import Gray

if TYPE_CHECKING:
    from ...factory.sonar.geometry import FanGeometry

Maps = tuple[Gray, Gray]
"""Columns and rows to look up, as OpenCV's remap takes them."""


def richardson_lucy_range(
    image: Gray, sigma_px: float, iterations: int, geometry: FanGeometry | None = None
) -> Gray:
    """Richardson (1972) and Lucy (1974) with a Gaussian point-spread along range.

    image: (H, W) in 0..1.  sigma_px: of the blur, in pixels of the picture.  geometry: where range
    and bearing are.  A fan is resampled to a polar picture (a bin a pixel, a beam a pixel at the
    far edge), deconvolved there, and what that changed is resampled back and added, so that the
    resampling itself blurs nothing.  Pixels outside of the sector stay.

    Without geometry, and in a polar picture, range is along the columns.  In a fan that is right
    at the centre bearing alone: at a bearing b a part cos b of the blur is seen and sin b goes
    sideways (0.91 and 0.42 at 25 degrees).
    """
    if geometry is None or geometry.layout == "polar":
        return _along_columns(image, sigma_px, iterations)
    polar_maps, (columns, rows), inside = _fan_maps(geometry, image.shape)
    polar: Gray = np.asarray(
        cv2.remap(image, *polar_maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )
    change: Gray = _along_columns(polar, sigma_px, iterations) - polar
    back = cv2.remap(change, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(np.where(inside, np.maximum(image + back, 0), image), dtype=np.float32)


def _along_columns(image: Gray, sigma_px: float, iterations: int) -> Gray:
    observed = np.maximum(image.astype(np.float64), 0)
    estimate = np.maximum(observed, 1e-4)

    def blurred(values: object) -> object:
        return ndimage.gaussian_filter1d(values, sigma_px, axis=0, mode="nearest")

    # The kernel is symmetric, so that correlating with it is convolving with it.
    for _ in range(iterations):
        expected = np.maximum(np.asarray(blurred(estimate)), 1e-6)
        estimate = estimate * np.asarray(blurred(observed / expected))
    return np.asarray(estimate, dtype=np.float32)


@lru_cache(maxsize=4)
def _fan_maps(
    geometry: FanGeometry, shape: tuple[int, int]
) -> tuple[Maps, Maps, npt.NDArray[np.bool_]]:
    """Where the polar picture looks in the fan, where the fan looks in it, and the sector."""
    first, last = geometry.azimuth_min_rad, geometry.azimuth_max_rad
    bins = max(round((1 - geometry.near_fraction) * geometry.far_px), 2)
    beams = max(math.ceil(geometry.far_px * (last - first)), 2)
    depth, width = (1 - geometry.near_fraction) / bins, (last - first) / beams
    fraction = geometry.near_fraction + (np.arange(bins) + 0.5)[:, None] * depth
    azimuth_rad = first + (np.arange(beams) + 0.5)[None] * width
    rows, columns = np.broadcast_arrays(*geometry.pixels(fraction, azimuth_rad))
    maps = geometry.maps(0, 0, *shape)
    back = (
        (maps["azimuth_rad"] - np.float32(first)) / np.float32(width) - np.float32(0.5),
        (maps["range_fraction"] - np.float32(geometry.near_fraction)) / np.float32(depth)
        - np.float32(0.5),
    )
    to_polar = (columns.astype(np.float32), rows.astype(np.float32))
    return to_polar, back, maps["sector"] > 0
