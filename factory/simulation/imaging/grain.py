"""The points of the world whose echoes make the grain of a frame.

The world is divided into cells about as large as what the device resolves; see `grain_kernels`.
Each cell holds one point, whose name, place and coefficient follow from the cell alone: the same
point echoes in every frame that shows its place, wherever the camera's pixels fall.  How strong it
is follows from the frame: the points of a bin share the power that the sonar equation gives it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...common.array_types import Float32s, Float64s, Int32s, UInt16s, UInt32s
from ...common.errors import FrameError
from ..sonar import array
from .scatterers import camera_rays, grid_of, polar_bins

if TYPE_CHECKING:
    from .ghosts import GhostScatterers
    from .signal import Ping

# Cells in an area that the device resolves; more change neither the statistics nor the hold.
_CELLS_RESOLVED = 6.0
_NEAREST_M = 0.05
_EDGE_BINS = 0.125
_MOST_POINTS = 1 << 26


class PointEchoes(NamedTuple):
    """N points that echo coherently, in the order of the arguments of `kernels.scatter`.

    bins: (N,) int32 flat polar bin.
    amplitudes: (N,) float32 root of the power without absorption.
    names: (N,) uint32, what the random coefficient of the point is drawn by.
    phases: (N,) uint16 phase of the two-way path, 65536ths of a turn; (0,): all 0.
    """

    bins: Int32s
    amplitudes: Float32s
    names: UInt32s
    phases: UInt16s

    def first(self, count: int) -> PointEchoes:
        """The first points."""
        return PointEchoes(
            self.bins[:count], self.amplitudes[:count], self.names[:count], self.phases[:count]
        )

    def followed_by(self, others: PointEchoes) -> PointEchoes:
        """These points, then others."""
        return PointEchoes(
            np.concatenate([self.bins, others.bins]),
            np.concatenate([self.amplitudes, others.amplitudes]),
            np.concatenate([self.names, others.names]),
            np.concatenate([self.phases, others.phases]),
        )


class CellSizes(NamedTuple):
    """Edges of cells by range, in half octaves.

    edges_m: (L,) metres.  squares_m2: (L + 1,) squares of the ranges between which each is used.
    """

    edges_m: Float64s
    squares_m2: Float64s

    def edge_at_m(self, range_m: Float64s) -> Float64s:
        """(N,) edges of cells at these ranges."""
        level = np.searchsorted(self.squares_m2[1:-1], range_m * range_m, side="right")
        return np.asarray(self.edges_m[level])


def grain_points(ping: Ping, turns_per_m: float) -> PointEchoes:
    """All points that echo, in order of the camera's pixels, then those of ghosts.

    turns_per_m: of the phase of an echo, per metre of range; 0: without phases.
    Raises FrameError when there are too many.
    """
    scene = ping.scatterers
    sizes = cell_sizes(ping)
    points = _surface_points(ping, sizes, turns_per_m)
    if scene.ghosts is not None:
        ghosts = _ghost_points(ping, scene.ghosts, sizes, turns_per_m)
        points = points.followed_by(ghosts)
    return points if turns_per_m else points._replace(phases=np.empty(0, np.uint16))


def cell_sizes(ping: Ping) -> CellSizes:
    """Sizes of cells of which `_CELLS_RESOLVED` fill a range bin or pulse times a beam."""
    device = ping.sonar
    length_m = max(ping.bin_m, ping.resolution_m)
    spacing = float(np.diff(np.sin(device.beam_centres_rad())).mean())
    width = max(array.beam_width_sine(device.array), spacing)
    square_per_m = length_m * width / _CELLS_RESOLVED
    nearest_m = max(ping.window.range_min_m, _NEAREST_M)
    # Of powers of two, squares are exact: half octaves of the edge are octaves of its square.
    first = int(np.floor(np.log2(square_per_m * nearest_m)))
    last = max(int(np.floor(np.log2(square_per_m * ping.window.range_max_m))), first)
    squares = 2.0 ** np.arange(first, last + 1)
    used_from_m = squares / square_per_m
    used_from_m[0] = 0
    return CellSizes(np.sqrt(squares), np.append(used_from_m**2, np.inf))


def _edge_bins(ping: Ping) -> float:
    """How near to the edge of a range bin a point lies in both, in bins.

    Without it a step of some millimetres takes part of the points from one bin to the next at once.
    A pulse that is longer than a bin spreads them anyway, and points in two bins would add power.
    """
    return _EDGE_BINS * max(1 - ping.resolution_m / ping.bin_m, 0.0)


def _surface_points(ping: Ping, sizes: CellSizes, turns_per_m: float) -> PointEchoes:
    """The points of surfaces, static and moving."""
    from . import grain_kernels  # loads numba

    scene = ping.scatterers
    mount = ping.sonar.mount
    turn = mount.rotation_sonar_from_camera()
    x_m, y_m, z_m = mount.position_camera_m()
    # Spelled out: a matrix product may round differently on other processors.
    offset_m = -(turn[:, 0] * x_m + turn[:, 1] * y_m + turn[:, 2] * z_m)
    axes = (
        np.ascontiguousarray(scene.world_from_camera[:3]),
        np.ascontiguousarray(np.column_stack([turn, offset_m])),
    )
    power = scene.surface_power.reshape(-1)
    arguments = (
        tuple(camera_rays(scene.frame)), scene.echoes, scene.joins_below, axes,
        scene.moving_pixels(), grid_of(ping.window, ping.sonar), tuple(sizes), turns_per_m,
    )  # fmt: skip
    edge_bins = np.float32(_edge_bins(ping))
    room = int(2 * _CELLS_RESOLVED * power.size)
    while True:
        total = np.zeros(power.size, np.float32)
        points = _empty_points(room)
        count = grain_kernels.strew(*arguments, (power, total, edge_bins, tuple(points)))
        if count + power.size <= room:
            break
        if count > _MOST_POINTS:
            raise FrameError(
                f"{scene.frame.ref.name}: {count} points of grain; the device resolves too much of "
                "this frame: set fewer sonar.range_bins or a smaller sonar.range.max_m"
            )
        room = count + power.size
    count = grain_kernels.normalise(count, power, total, tuple(points))
    return points.first(count)


def _empty_points(room: int) -> PointEchoes:
    return PointEchoes(
        np.empty(room, np.int32),
        np.empty(room, np.float32),
        np.empty(room, np.uint32),
        np.empty(room, np.uint16),
    )


def _ghost_points(
    ping: Ping, ghosts: GhostScatterers, sizes: CellSizes, turns_per_m: float
) -> PointEchoes:
    """The points of mirror images."""
    from . import grain_kernels  # loads numba

    occupied = ghosts.points(sizes)
    bins = polar_bins(occupied.sonar_m, ping.window, ping.sonar)
    size = ping.scatterers.power.size
    power = np.bincount(ghosts.bins, ghosts.powers, size).astype(np.float32)
    chosen = np.flatnonzero(bins >= 0)
    chosen = chosen[power[bins[chosen]] > 0]
    count = len(chosen)
    ahead_m, left_m, up_m = occupied.sonar_m[:, chosen]
    turns = np.sqrt(ahead_m * ahead_m + left_m * left_m + up_m * up_m) * turns_per_m
    points = _empty_points(count + size)
    points.bins[:count] = bins[chosen]
    points.amplitudes[:count] = occupied.powers[chosen]
    points.names[:count] = occupied.names[chosen]
    points.phases[:count] = ((turns - np.floor(turns)) * 65536).astype(np.uint16)
    total = np.bincount(bins[chosen], occupied.powers[chosen], size).astype(np.float32)
    count = grain_kernels.normalise(count, power, total, tuple(points))
    return points.first(count)
