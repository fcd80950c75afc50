"""Echoes, and the polar image that they make: range bins x beams; elevation is lost."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, reduce
from typing import NamedTuple

import numpy as np

from ...common.array_types import Bools, Float32s, Float64s, Floats, Int32s
from .settings import SonarSettings
from .window import Window

# Bins smaller than the pixel grid of the camera leave pinholes up to this far from an echo.
_PINHOLE_ROWS = 2
_PINHOLE_BEAMS = 1


class EvenGrid(NamedTuple):
    """Cells that divide ranges and azimuths evenly, in the order of `kernels._GRID`.

    Compiled loops take it as a plain tuple.  Their cached machine code is looked up by the types of
    the members alone, so after a change of order it would read the wrong ones.

    top_view: whether distances are along the ground, and not slant ranges.
    near_m, span_m: nearest distance and extent of the rows, metres.
    left_rad: azimuth of the left edge.
    columns_per_rad: columns of a radian of azimuth.
    """

    top_view: bool
    near_m: np.float32
    span_m: np.float32
    rows: int
    left_rad: np.float32
    columns_per_rad: np.float32
    columns: int


class PolarGrid(NamedTuple):
    """The polar cells that echoes fall into.

    even: rows, and the columns of uniform beams.
    edges_rad: (beams - 1,) float32 azimuths between neighbouring tabled beams, which replace the
        even columns; (0,) for uniform beams.
    """

    even: EvenGrid
    edges_rad: Float32s


@dataclass(frozen=True, eq=False)
class Echoes:
    """N echoes around the sonar (x forward, y left, z up).

    range_m: (N,) float32 slant range.
    azimuth_rad: (N,) float32, positive to the RIGHT, as a fan image shows it.
    elevation_rad: (N,) float32, positive up.
    strength: (N,) float32 linear echo strength; 0 = a surface that the sound does not reach.
    """

    range_m: Float32s
    azimuth_rad: Float32s
    elevation_rad: Float32s
    strength: Float32s

    def __len__(self) -> int:
        return int(self.range_m.shape[0])

    def range_in(self, window: Window) -> Float32s:
        """(N,) float32 distance under the window's projection, metres."""
        if window.projection == "slant_range":
            return self.range_m
        return np.asarray(self.range_m * np.cos(self.elevation_rad), dtype=np.float32)

    def in_conical_beams(self) -> Echoes:
        """The echoes with bearings for azimuths, as a line of elements hears them.

        Its beams are cones around the line: sin(bearing) = sin(azimuth) cos(elevation).
        """
        bearing_rad = np.arcsin(np.sin(self.azimuth_rad) * np.cos(self.elevation_rad))
        return replace(self, azimuth_rad=np.asarray(bearing_rad, np.float32))

    def azimuths_of_bearings(self) -> Float32s:
        """(N,) azimuths of echoes whose azimuths are bearings: `in_conical_beams` backwards."""
        sine = np.sin(self.azimuth_rad) / np.cos(self.elevation_rad)
        return np.asarray(np.arcsin(np.clip(sine, -1, 1)))

    def xyz_m(self) -> Float64s:
        """(N, 3) Cartesian coordinates in sonar axes, metres."""
        range_m = self.range_m.astype(np.float64)
        ground_m = range_m * np.cos(self.elevation_rad)
        forward_m = ground_m * np.cos(self.azimuth_rad)
        right_m = ground_m * np.sin(self.azimuth_rad)
        up_m = range_m * np.sin(self.elevation_rad)
        return np.stack([forward_m, -right_m, up_m], axis=1)


def from_xyz(points_m: Floats, strength: Floats) -> Echoes:
    """Return echoes at (N, 3) Cartesian points in sonar axes, metres, with (N,) strengths."""
    x, y, z = np.asarray(points_m).reshape(-1, 3).T
    ground_m = np.hypot(x, y)
    return Echoes(
        range_m=np.asarray(np.hypot(ground_m, z), np.float32),
        azimuth_rad=np.asarray(np.arctan2(-y, x), np.float32),
        elevation_rad=np.asarray(np.arctan2(z, ground_m), np.float32),
        strength=np.asarray(strength, np.float32),
    )


def in_plane(
    range_m: Floats,
    azimuth_rad: Floats,
    strength: Floats,
) -> Echoes:
    """Return echoes at elevation 0, for noise that is drawn at ranges and azimuths alone."""
    return Echoes(
        range_m=np.asarray(range_m, np.float32),
        azimuth_rad=np.asarray(azimuth_rad, np.float32),
        elevation_rad=np.zeros(len(range_m), np.float32),
        strength=np.asarray(strength, np.float32),
    )


def bin_index(echoes: Echoes, window: Window, sonar: SonarSettings) -> Int32s:
    """Return the (N,) int32 flat index range_bin * beams + beam of each echo.

    range_bin = floor((distance - range_min) / range_span * range_bins), distance by the window's
    projection.  Uniform beams: floor((azimuth + hfov/2) * beams / hfov).  Tabled beams: the nearest
    direction.  range_bins * beams for an echo outside the window or sector.
    """
    return _cell_of_each(echoes, polar_grid(window, sonar))


def polar_grid(window: Window, sonar: SonarSettings) -> PolarGrid:
    """Return the polar bins of an image, with the edges of tabled beams."""
    half_hfov_rad = np.float32(np.deg2rad(sonar.hfov_deg) / 2)
    even = EvenGrid(
        top_view=window.projection == "top_view",
        near_m=np.float32(window.range_min_m),
        span_m=np.float32(window.range_span_m),
        rows=sonar.range_bins,
        left_rad=-half_hfov_rad,
        columns_per_rad=np.float32(sonar.beams / (2 * half_hfov_rad)),
        columns=sonar.beams,
    )
    if sonar.beam_azimuths_deg is None:
        return PolarGrid(even, np.empty(0, np.float32))
    centres_rad = sonar.beam_centres_rad()
    return PolarGrid(even, ((centres_rad[1:] + centres_rad[:-1]) / 2).astype(np.float32))


def count_echoes(echoes: Echoes, window: Window, rows: int, columns: int) -> Int32s:
    """Return the (rows, columns) int32 number of insonified echoes in each cell of the window.

    The cells divide the range window and the sector that the camera saw evenly.
    """
    even = EvenGrid(
        top_view=window.projection == "top_view",
        near_m=np.float32(window.range_min_m),
        span_m=np.float32(window.range_span_m),
        rows=rows,
        left_rad=np.float32(window.azimuth_min_rad),
        columns_per_rad=np.float32(columns / max(window.azimuth_span_rad, 1e-9)),
        columns=columns,
    )
    cell_of_each = _cell_of_each(echoes, PolarGrid(even, np.empty(0, np.float32)))
    is_insonified = echoes.strength > 0
    echo_count = np.bincount(cell_of_each[is_insonified], minlength=rows * columns + 1)
    # The last cell holds the echoes outside the window.
    return echo_count[:-1].astype(np.int32).reshape(rows, columns)


def _cell_of_each(echoes: Echoes, grid: PolarGrid) -> Int32s:
    """Return the (N,) int32 flat cell of each echo, rows * columns outside the grid."""
    from . import kernels  # loads numba

    cell_of_each = np.empty(len(echoes), np.int32)
    coordinates = (
        np.ascontiguousarray(echoes.range_m),
        np.ascontiguousarray(echoes.azimuth_rad),
        np.ascontiguousarray(echoes.elevation_rad),
    )
    kernels.bin_of_each(coordinates, tuple(grid.even), grid.edges_rad, cell_of_each)
    return cell_of_each


def accumulate(echoes: Echoes, window: Window, sonar: SonarSettings, *more: Echoes) -> Float32s:
    """Return the echo level of each bin: the mean, max or sum of its echoes' strengths.

    more: further echoes of the same cloud, which saves joining them.
    Returns (range_bins, beams) float32.
    """
    from . import kernels  # loads numba

    level = np.zeros(sonar.range_bins * sonar.beams + 1, np.float32)
    echo_count = np.zeros(level.size, np.intp)
    is_mean = sonar.accumulate == "mean"
    keeps_loudest = sonar.accumulate == "max"
    for part in (echoes, *more):
        bins = bin_index(part, window, sonar)
        strength = np.ascontiguousarray(part.strength)
        # Sums the echoes of each bin unless only the loudest counts.
        kernels.gather(bins, strength, keeps_loudest, level)
        if is_mean:
            echo_count += np.bincount(bins[strength > 0], minlength=level.size)
    if is_mean:
        level /= np.maximum(echo_count, 1)
    # The last cell holds the echoes outside the window.
    return level[:-1].reshape(sonar.range_bins, sonar.beams)


def spread_points(level: Float32s, sonar: SonarSettings) -> Float32s:
    """Return the image blurred by the device's point-spread.

    Keeps the echo energy, except for what is spread beyond the border of the image.
    """
    from . import kernels  # loads numba

    blurred = np.empty(level.shape, np.float32)
    down = gaussian(sonar.point_spread.range_bins)
    across = gaussian(sonar.point_spread.beams)
    kernels.blur(np.ascontiguousarray(level, dtype=np.float32), down, across, blurred)
    return blurred


@cache
def gaussian(sigma: float) -> Float32s:
    """Return (2 n + 1,) float32 Gaussian weights of `sigma` cells, cut at 3 sigma; sum 1."""
    reach = int(3 * sigma + 0.5)
    step = np.arange(-reach, reach + 1)
    weight = np.exp(-0.5 * (step / sigma) ** 2) if sigma > 0 else np.ones(1)
    return np.asarray(weight / weight.sum(), dtype=np.float32)


def covered(hit: Bools) -> Bools:
    """Return (range_bins, beams) bool: bins that some insonified surface fills.

    Closes pinholes, which are no shadow: bins without an echo because they are smaller than the
    pixel grid of the camera.

    hit: (range_bins, beams) bool, bins that hold an echo of the full-density cloud.
    """
    box_rows = 2 * _PINHOLE_ROWS + 1
    box_beams = 2 * _PINHOLE_BEAMS + 1
    # Dilated beyond the border and then eroded, so that the border does not erode the surface.
    padded = np.pad(hit, [(box_rows - 1, box_rows - 1), (box_beams - 1, box_beams - 1)])
    dilated = _reduce_boxes(np.logical_or, padded, box_rows, box_beams)
    return _reduce_boxes(np.logical_and, dilated, box_rows, box_beams)


def _reduce_boxes(combine: np.ufunc, mask: Bools, box_rows: int, box_columns: int) -> Bools:
    """Combine the values of each box that lies within the mask.

    Returns (height - box_rows + 1, width - box_columns + 1) bool, by the box's top left corner.
    """
    height = mask.shape[0] - box_rows + 1
    width = mask.shape[1] - box_columns + 1
    of_columns = reduce(combine, (mask[row : row + height] for row in range(box_rows)))
    shifted = (of_columns[:, column : column + width] for column in range(box_columns))
    return np.asarray(reduce(combine, shifted))


def seen_beams(window: Window, sonar: SonarSettings) -> Bools:
    """Return (beams,) bool: beams within the part of the sector that the camera saw."""
    centres_rad = sonar.beam_centres_rad()
    half_beam_rad = np.deg2rad(sonar.hfov_deg) / sonar.beams / 2
    ends_after_left_edge = centres_rad + half_beam_rad > window.azimuth_min_rad
    begins_before_right_edge = centres_rad - half_beam_rad < window.azimuth_max_rad
    return np.asarray(ends_after_left_edge & begins_before_right_edge)


def where_seen(image: Float32s, window: Window, sonar: SonarSettings) -> Float32s:
    """The (range_bins, beams) image, 0 in beams that the camera did not see."""
    is_seen = seen_beams(window, sonar)
    return image if is_seen.all() else np.where(is_seen, image, np.float32(0))
