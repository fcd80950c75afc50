"""The share of a fan's outline that an image shows: where the lit area ends."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ....factory.common.array_types import Bools, Float64s
from ....factory.dataset.fan_geometry import FanGeometry
from .lit_pixels import nearest_pixels, sample_nearest

_MIN_INNER_SHARE = 0.1  # share of lit pixels just inside the outline
_OUTER_OF_INNER = 0.35  # share of lit pixels just outside, as a part of that
_PIECES = 12  # of each side of the outline, each of which is seen or not
_SAMPLES_PER_PIECE = 12  # along the outline


class _Points(NamedTuple):
    """Points by range, as shares of the largest, and bearing, radians; both broadcast."""

    range_fraction: Float64s
    azimuth_rad: Float64s


class _Side(NamedTuple):
    """Points just inside and just outside one side of an outline."""

    inside: _Points
    outside: _Points


class OutlinePixels(NamedTuple):
    """Pixels just inside and just outside an outline.

    Both are (3, pieces, samples) indices of the flattened image, -1 outside the image.  The first
    axis is the left edge, the right edge and the far arc, each cut into pieces of some samples.
    """

    inside: npt.NDArray[np.intp]
    outside: npt.NDArray[np.intp]


def measure_confidence(lit: Bools, fan: FanGeometry) -> float:
    """0..1, the share of the outline at which the lit area visibly ends, see `light_ends`.

    Both edges and the far arc count alike: a fan whose outline is half in the dark has 0.5.
    """
    sides_seen = []
    for side in _outline_sides(fan):
        inner_share = _lit_shares(lit, fan, side.inside)
        outer_share = _lit_shares(lit, fan, side.outside)
        sides_seen.append(light_ends(inner_share, outer_share))
    return float(np.mean(sides_seen))


def light_ends(inner_share: Float64s, outer_share: Float64s) -> Bools:
    """Whether the lit area ends, by the shares of pixels lit just inside and outside an outline.

    More than `_MIN_INNER_SHARE` must be lit inside, and less than `_OUTER_OF_INNER` of that
    outside.
    """
    return (inner_share > _MIN_INNER_SHARE) & (outer_share < _OUTER_OF_INNER * inner_share)


def outline_pixels(fan: FanGeometry, height: int, width: int) -> OutlinePixels:
    """The pixels beside the outline of a fan, in an image of this size."""

    def indices(points: _Points) -> npt.NDArray[np.intp]:
        pixels = nearest_pixels(*fan.pixels(*points), height, width)
        return pixels.reshape(_PIECES, -1)

    sides = _outline_sides(fan)
    return OutlinePixels(
        inside=np.stack([indices(side.inside) for side in sides]),
        outside=np.stack([indices(side.outside) for side in sides]),
    )


def _outline_sides(fan: FanGeometry) -> tuple[_Side, _Side, _Side]:
    """The left edge, the right edge and the far arc."""
    sample_count = _PIECES * _SAMPLES_PER_PIECE
    left_rad = fan.azimuth_min_rad
    right_rad = fan.azimuth_max_rad
    # Some pixels away from the outline, as shares of the largest range.
    offsets: Float64s = np.maximum(np.linspace(0.004, 0.02, 5), np.arange(2, 7) / fan.far_px)
    # The ends of edges and arc are left out: there two sides meet.
    ranges = np.linspace(fan.near_fraction + 0.03, 0.97, sample_count)[:, None]
    bearings = np.linspace(left_rad, right_rad, sample_count + 8)[4:-4, None]
    offsets_rad = offsets / ranges
    return (
        _Side(_Points(ranges, left_rad + offsets_rad), _Points(ranges, left_rad - offsets_rad)),
        _Side(_Points(ranges, right_rad - offsets_rad), _Points(ranges, right_rad + offsets_rad)),
        _Side(_Points(1.0 - offsets, bearings), _Points(1.0 + offsets, bearings)),
    )


def _lit_shares(lit: Bools, fan: FanGeometry, points: _Points) -> Float64s:
    """(_PIECES,) share of the points of each piece that are lit; 0 outside the image."""
    samples = sample_nearest(lit, *fan.pixels(*points))
    lit_counts = samples.values.reshape(_PIECES, -1).sum(axis=1)
    counts = samples.is_inside.reshape(_PIECES, -1).sum(axis=1)
    return np.asarray(lit_counts / np.maximum(counts, 1))
