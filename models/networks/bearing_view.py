"""Whole bearings of an image, resampled for the head that finds interference along them."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Float32s
from ...factory.dataset.fan_geometry import FanGeometry

BEARINGS = 256
RANGES = 512
SEGMENTS = 16
"""Parts of the ranges."""
NODES = 5
"""Ranges at which the head states how much interference there is, from the nearest to the last."""
LEAST_SHARE = 0.05
"""Of an image that remains along a bearing."""
_DARKEST = 0.25


class Sector(NamedTuple):
    """Limits of the data: range as fractions of the largest, bearings in radians."""

    near: float
    far: float
    left_rad: float
    right_rad: float


def sector_of(geometry: FanGeometry) -> Sector:
    """The sector that holds data."""
    bearings = geometry.beam_azimuths_rad
    left = geometry.azimuth_min_rad
    right = geometry.azimuth_max_rad
    if bearings:
        left = max(left, bearings[0])
        right = min(right, bearings[-1])
    return Sector(geometry.near_fraction, 1.0, left, right)


def bearing_view(grey: Float32s, geometry: FanGeometry) -> Float32s:
    """(2, RANGES, BEARINGS) of an image (H, W): grey values, and 1 where the image has any."""
    sector = sector_of(geometry)
    down = (np.arange(RANGES, dtype=np.float32) + np.float32(0.5)) / RANGES
    across = (np.arange(BEARINGS, dtype=np.float32) + np.float32(0.5)) / BEARINGS
    range_fraction = sector.near + (sector.far - sector.near) * down[:, None]
    azimuth_rad = sector.left_rad + (sector.right_rad - sector.left_rad) * across[None]
    row, column = (
        np.ascontiguousarray(np.broadcast_to(position, (RANGES, BEARINGS)), np.float32)
        for position in geometry.pixels(range_fraction, azimuth_rad)
    )
    height, width = grey.shape
    is_known = (row > -0.5) & (row < height - 0.5) & (column > -0.5) & (column < width - 0.5)
    values = cv2.remap(grey, column, row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(np.stack([values * is_known, is_known]), np.float32)


def segment_means(view: Float32s) -> Float32s:
    """(SEGMENTS, BEARINGS) means along range of a view's grey values, where they are known."""
    values, known = (plane.reshape(SEGMENTS, -1, BEARINGS).sum(axis=1) for plane in view)
    return np.asarray(values / np.maximum(known, 1), np.float32)


def remaining_share(nodes: Float32s, view: Float32s) -> Float32s:
    """(SEGMENTS, BEARINGS) factors on an image that take off what the head states, 0 to 1.

    nodes: (NODES, BEARINGS).  Echoes and interference fade together, so no streak of its speckle is
    left, as a difference would leave it.  No bearing becomes darker than a quarter of those without
    interference are at that range.
    """
    ranges = (np.arange(SEGMENTS) + 0.5) / SEGMENTS * (NODES - 1)
    before = np.minimum(ranges.astype(int), NODES - 2)
    part = (ranges - before).astype(np.float32)[:, None]
    amount = nodes[before] * (1 - part) + nodes[before + 1] * part
    held = np.maximum(segment_means(view), 1e-3)
    shares = np.clip(1 - np.maximum(amount, 0) / held, LEAST_SHARE, 1)
    undisturbed = nodes.max(axis=0) <= 0
    if undisturbed.any():
        darkest = np.quantile(held[:, undisturbed], _DARKEST, axis=1)[:, None]
        shares = np.maximum(shares, np.minimum(darkest / held, 1))
    return np.asarray(shares, np.float32)


def share_at(
    shares: Float32s, sector: Sector, range_fraction: Float32s, azimuth_rad: Float32s
) -> Float32s:
    """(H, W) of `remaining_share` at the pixels of an image."""
    down = (range_fraction - sector.near) / (sector.far - sector.near) * SEGMENTS - 0.5
    span_rad = sector.right_rad - sector.left_rad
    across = (azimuth_rad - sector.left_rad) / span_rad * BEARINGS - 0.5
    positions = across.astype(np.float32), down.astype(np.float32)
    return np.asarray(
        cv2.remap(shares, *positions, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    )
