"""Echoes, and the polar image that they make: range bins x beams; elevation is lost."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, reduce

import numpy as np
import numpy.typing as npt

from .settings import SonarSettings
from .window import Window

Polar = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]
Grid = tuple[tuple[bool, np.float32, np.float32, int, np.float32, np.float32, int], Polar]

# Bins smaller than the pixel grid of the camera leave pinholes up to this far from an echo.
_PINHOLE_ROWS, _PINHOLE_BEAMS = 2, 1


@dataclass(frozen=True, eq=False)
class Echoes:
    """N echoes around the sonar (x forward, y left, z up).

    range_m: (N,) float32 slant range.
    azimuth_rad: (N,) float32, positive to the RIGHT, as a fan picture shows it.
    elevation_rad: (N,) float32, positive up.
    strength: (N,) float32 linear echo strength; 0 = a surface that the sound does not reach.
    """

    range_m: Polar
    azimuth_rad: Polar
    elevation_rad: Polar
    strength: Polar

    def __len__(self) -> int:
        return int(self.range_m.shape[0])

    def range_in(self, window: Window) -> Polar:
        """(N,) float32 distance under the window's projection, metres."""
        if window.projection == "slant_range":
            return self.range_m
        return np.asarray(self.range_m * np.cos(self.elevation_rad), dtype=np.float32)

    def xyz_m(self) -> npt.NDArray[np.float64]:
        """(N, 3) Cartesian coordinates in sonar axes, metres."""
        range_m = self.range_m.astype(np.float64)
        ground_m = range_m * np.cos(self.elevation_rad)
        forward, right = ground_m * np.cos(self.azimuth_rad), ground_m * np.sin(self.azimuth_rad)
        return np.stack([forward, -right, range_m * np.sin(self.elevation_rad)], axis=1)


def from_xyz(points_m: npt.NDArray[np.floating], strength: npt.NDArray[np.floating]) -> Echoes:
    """Polar echoes from (N, 3) Cartesian points in sonar axes and their (N,) strengths."""
    x, y, z = np.asarray(points_m).reshape(-1, 3).T
    ground_m = np.hypot(x, y)
    places = np.hypot(ground_m, z), np.arctan2(-y, x), np.arctan2(z, ground_m)
    return Echoes(*(np.asarray(values, np.float32) for values in (*places, strength)))


def in_plane(
    range_m: npt.NDArray[np.floating],
    azimuth_rad: npt.NDArray[np.floating],
    strength: npt.NDArray[np.floating],
) -> Echoes:
    """Echoes at elevation 0: noise is placed in the picture, where elevation is lost anyway."""
    given = range_m, azimuth_rad, np.zeros(len(range_m)), strength
    return Echoes(*(np.asarray(values, np.float32) for values in given))


def bin_index(echoes: Echoes, window: Window, sonar: SonarSettings) -> npt.NDArray[np.int32]:
    """(N,) int32 flat index range_bin * beams + beam of each echo.

    range_bin = floor((distance - range_min) / range_span * range_bins), distance by the window's
    projection.  Uniform beams: floor((azimuth + hfov/2) * beams / hfov).  Tabled beams: the nearest
    direction.  range_bins * beams for an echo outside the window or sector.
    """
    return _cells(echoes, grid(window, sonar))


def grid(window: Window, sonar: SonarSettings) -> Grid:
    """The bins of a picture, and the edges of tabled beams, as `kernels` want them."""
    half = np.float32(np.deg2rad(sonar.hfov_deg) / 2)
    edges = np.empty(0, np.float32)
    if sonar.beam_azimuths_deg is not None:
        centres = sonar.beam_centres_rad()
        edges = ((centres[1:] + centres[:-1]) / 2).astype(np.float32)
    beams_per_rad = np.float32(sonar.beams / (2 * half))
    return (*_ranges(window), sonar.range_bins, -half, beams_per_rad, sonar.beams), edges


def _ranges(window: Window) -> tuple[bool, np.float32, np.float32]:
    near_m, span_m = np.float32(window.range_min_m), np.float32(window.range_span_m)
    return window.projection == "top_view", near_m, span_m


def density(echoes: Echoes, window: Window, rows: int, columns: int) -> npt.NDArray[np.int32]:
    """(rows, columns) int32 number of insonified echoes in each cell of the window.

    The cells divide the range window and the sector that the camera saw evenly.
    """
    left_rad = np.float32(window.azimuth_min_rad)
    per_rad = np.float32(columns / max(window.azimuth_span_rad, 1e-9))
    bins = (*_ranges(window), rows, left_rad, per_rad, columns), np.empty(0, np.float32)
    cells = _cells(echoes, bins)[echoes.strength > 0]
    count = np.bincount(cells, minlength=rows * columns + 1)
    return count[:-1].astype(np.int32).reshape(rows, columns)


def _cells(echoes: Echoes, bins: Grid) -> npt.NDArray[np.int32]:
    from . import kernels  # loads numba

    cells = np.empty(len(echoes), np.int32)
    places = (echoes.range_m, echoes.azimuth_rad, echoes.elevation_rad)
    kernels.bin_of_each(tuple(map(np.ascontiguousarray, places)), *bins, cells)
    return cells


def accumulate(echoes: Echoes, window: Window, sonar: SonarSettings, *more: Echoes) -> Polar:
    """(range_bins, beams) float32 echo level: mean, max or sum of the strengths in each bin.

    more: further echoes of the same cloud, which then need not be joined.
    """
    from . import kernels  # loads numba

    level = np.zeros(sonar.range_bins * sonar.beams + 1, np.float32)
    count, how = np.zeros(level.size, np.intp), sonar.accumulate
    for part in (echoes, *more):
        bins, strength = bin_index(part, window, sonar), np.ascontiguousarray(part.strength)
        kernels.gather(bins, strength, how == "max", level)
        if how == "mean":
            count += np.bincount(bins[strength > 0], minlength=level.size)
    if how == "mean":
        level /= np.maximum(count, 1)
    return level[:-1].reshape(sonar.range_bins, sonar.beams)


def spread_points(level: Polar, sonar: SonarSettings) -> Polar:
    """Blur by the device's point-spread; echo energy is kept except at the picture's border."""
    from . import kernels  # loads numba

    blurred = np.empty(level.shape, np.float32)
    down, across = gaussian(sonar.point_spread.range_bins), gaussian(sonar.point_spread.beams)
    kernels.blur(np.ascontiguousarray(level, dtype=np.float32), down, across, blurred)
    return blurred


@cache
def gaussian(sigma: float) -> npt.NDArray[np.float32]:
    """(2 n + 1,) float32 weights of a Gaussian of `sigma` cells, cut at three sigma; sum 1."""
    reach = int(3 * sigma + 0.5)
    step = np.arange(-reach, reach + 1)
    weight = np.exp(-0.5 * (step / sigma) ** 2) if sigma > 0 else np.ones(1)
    return np.asarray(weight / weight.sum(), dtype=np.float32)


def covered(hit: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """(range_bins, beams) bool: bins that some insonified surface fills.

    hit: (range_bins, beams) bool, bins that hold an echo of the full-density cloud.  Bins smaller
    than the pixel grid of the camera leave pinholes that are no shadow: they are closed.
    """
    size = 2 * _PINHOLE_ROWS + 1, 2 * _PINHOLE_BEAMS + 1
    # A dilation that reaches beyond the picture, and an erosion of all of that.
    grown = _boxes(np.logical_or, np.pad(hit, [(side - 1, side - 1) for side in size]), *size)
    return _boxes(np.logical_and, grown, *size)


def _boxes(how: np.ufunc, mask: Mask, down: int, across: int) -> Mask:
    """All that lies in the (down, across) box from each place on, of those that lie within."""
    height, width = mask.shape[0] - down + 1, mask.shape[1] - across + 1
    rows = reduce(how, (mask[i : i + height] for i in range(down)))
    return np.asarray(reduce(how, (rows[:, j : j + width] for j in range(across))))


def seen_beams(window: Window, sonar: SonarSettings) -> npt.NDArray[np.bool_]:
    """(beams,) bool: beams within the part of the sector that the camera saw."""
    centres = sonar.beam_centres_rad()
    half = np.deg2rad(sonar.hfov_deg) / sonar.beams / 2
    return np.asarray(
        (centres + half > window.azimuth_min_rad) & (centres - half < window.azimuth_max_rad)
    )


def where_seen(picture: Polar, window: Window, sonar: SonarSettings) -> Polar:
    """The (range_bins, beams) picture, 0 in beams that the camera did not see."""
    seen = seen_beams(window, sonar)
    return picture if seen.all() else np.where(seen, picture, np.float32(0))
