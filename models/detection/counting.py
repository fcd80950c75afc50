"""Tracks as fisheries write them down: when, where, which way, how fast and how long."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Float64s
from .objects import Place, metres_per_pixel, place_of
from .tracker import Track, TrackPoint

CLASS = "object"
"""Class of whatever moves."""
_LENGTH_QUANTILE = 0.75  # of the lengths of its echoes: a body bends, and echoes break
_LENGTH_LOSS_PX = 2.0  # by which blur and threshold make echoes longer
_SPEED_FRAMES = 5  # over which steps are taken, so that jitter adds nothing


class TrackRow(NamedTuple):
    """A row of tracks.csv.  What is not known without a geometry, or without metres, is None.

    direction: left, right, towards or away, of the whole way.
    slant_range_m, bearing_deg: means.  length_sd_m: of the estimate of its length.
    score: median of its largest deviations from the background, in standard deviations.
    """

    file: str
    track: int
    class_name: str
    first_time_s: float | None
    last_time_s: float | None
    frames: int
    direction: str
    slant_range_m: float | None
    bearing_deg: float | None
    speed_m_s: float | None
    length_m: float | None
    length_sd_m: float | None
    score: float


def rows_of(file: str, tracks: Sequence[Track]) -> list[TrackRow]:
    """The rows of a recording's tracks, numbered from 1."""
    return [_row(file, number, track) for number, track in enumerate(tracks, start=1)]


def counts_of(rows: Sequence[TrackRow]) -> Counter[str]:
    """How many tracks go each way."""
    return Counter(row.direction for row in rows)


def way_direction(way: Float64s) -> str:
    """Left, right, towards or away, by the line that fits a way best.

    way: (N, 2) ahead of the sonar and to its right.
    """
    step = np.arange(len(way)) - (len(way) - 1) / 2
    ahead, right = step @ way
    if abs(right) >= abs(ahead):
        return "right" if right > 0 else "left"
    return "away" if ahead > 0 else "towards"


def _row(file: str, number: int, track: Track) -> TrackRow:
    places = _Places.of(track)
    lengths_m = [_length_m(point) for point in track.points]
    known_m = np.array([length for length in lengths_m if length is not None])
    length_m = None
    length_sd_m = None
    if len(known_m):
        length_m = float(np.quantile(known_m, _LENGTH_QUANTILE))
        length_sd_m = float(known_m.std() / math.sqrt(max(1, len(known_m) / 4)))
    return TrackRow(
        file,
        number,
        CLASS,
        track.points[0].frame.time_s,
        track.points[-1].frame.time_s,
        len(track.points),
        way_direction(places.way),
        places.mean_range_m,
        places.mean_bearing_deg,
        places.speed_m_s(track),
        length_m,
        length_sd_m,
        float(np.median([point.echo.peak for point in track.points])),
    )


class _Places(NamedTuple):
    """Where a track went: (N, 2) ahead of the sonar and to its right; metres, or pixels.

    bearings_deg, ranges_m: (N,) or None.
    """

    way: Float64s
    bearings_deg: Float64s | None
    ranges_m: Float64s | None

    @classmethod
    def of(cls, track: Track) -> _Places:
        geometry = track.points[0].frame.geometry
        if geometry is None:
            x, y = track.positions_px.T
            return cls(np.stack([-y, x], 1), None, None)
        found = [_place(point) for point in track.points]
        bearings = np.array([place.bearing_deg for place in found])
        ranges = [place.slant_range_m for place in found]
        if any(value is None for value in ranges):
            ranges = [_fraction(point) for point in track.points]
            metres = None
        else:
            metres = np.array(ranges, np.float64)
        radius = np.array(ranges, np.float64)
        angle = np.deg2rad(bearings)
        way = np.stack([radius * np.cos(angle), radius * np.sin(angle)], 1)
        return cls(way, bearings, metres)

    @property
    def mean_range_m(self) -> float | None:
        """Mean slant range."""
        return None if self.ranges_m is None else float(self.ranges_m.mean())

    @property
    def mean_bearing_deg(self) -> float | None:
        """Mean bearing, positive to the right."""
        return None if self.bearings_deg is None else float(self.bearings_deg.mean())

    def speed_m_s(self, track: Track) -> float | None:
        """Speed along its way."""
        times = [point.frame.time_s for point in track.points]
        if self.ranges_m is None or any(time is None for time in times):
            return None
        time_s = np.array(times, np.float64)
        step = min(_SPEED_FRAMES, len(time_s) - 1)
        elapsed_s = time_s[step:] - time_s[:-step]
        way_m = np.hypot(*(self.way[step:] - self.way[:-step]).T)
        is_later = elapsed_s > 0
        return float(np.median(way_m[is_later] / elapsed_s[is_later])) if is_later.any() else None


def _place(point: TrackPoint) -> Place:
    assert point.frame.geometry is not None
    return place_of(point.frame.geometry, point.echo.x, point.echo.y)


def _fraction(point: TrackPoint) -> float:
    """Distance from the apex in parts of the largest range."""
    geometry = point.frame.geometry
    assert geometry is not None
    right = (point.echo.x - geometry.apex_x_px) / geometry.x_scale
    return math.hypot(right, point.echo.y - geometry.apex_y_px) / geometry.far_px


def _length_m(point: TrackPoint) -> float | None:
    """Length of an echo along its longer axis."""
    geometry = point.frame.geometry
    scale_m = metres_per_pixel(geometry)
    if geometry is None or scale_m is None:
        return None
    across, along = point.echo.long_axis
    stretch = math.hypot(across / geometry.x_scale, along)
    return scale_m * stretch * max(0.0, point.echo.length_px - _LENGTH_LOSS_PX)
