"""Speckle of a moving sonar: the phase of every echo follows from its path."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s, Float64s, Int32s, UInt16s, UInt32s
from ...common.distribution import CellSize, Looks
from ...common.errors import FrameError
from ...common.settings import STRICT
from ..imaging.cells import places_in_cells
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.moving import static_index
from ..imaging.scatterers import camera_rays, polar_bins
from ..imaging.signal import Ping, PointEchoes, Signal, scattered
from ..sonar import array
from .speckle import expect_speckle

_MOST_POINTS = 1 << 25
# Fraction of the farthest range from which on a beam is at least a cell wide.
_CELL_WIDE_FROM = 0.25


@dataclass(frozen=True, config=STRICT)
class PathSpeckleSettings(EffectSettings):
    """Keys of `noise.path_speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    scatterer_m: edge of a world cell, metres; 0 takes about what the device tells apart.
    """

    looks: Looks = parameter(1, "1")
    scatterer_m: CellSize = parameter(0, "m")


class CellPoints(NamedTuple):
    """The world's cells as one point each.

    cells: (N,) uint32 names of the cells.
    powers: (N,) float32 intensity over the source level, without absorption.
    sonar_m: (3, N) float64 places in sonar axes (x forward, y left, z up), metres.
    """

    cells: UInt32s
    powers: Float32s
    sonar_m: Float64s


def path_speckle(
    signal: Signal, ping: Ping, rng: Rng, *, looks: float, scatterer_m: float
) -> Signal:
    """Speckle of a moving sonar: every echo has the phase of its two-way path.

    The cells of the world are points whose echoes turn in phase with their range.  A sonar at rest
    sees the same speckle in every frame, to the byte.  One that moves across its view loses the
    speckle over about half its aperture; one that turns or moves along its view keeps it for longer
    (Goodman, ch. 5).  Needs frames with poses, and a range window that stays the same
    (sonar.range.auto=false).  Raises FrameError when there are too many cells.
    """
    cell_m = scatterer_m or default_cell_m(ping)
    static_points = _place_static_points(ping, cell_m)
    moving_points = _place_moving_points(ping, cell_m)
    points = _join([static_points, *moving_points, *_place_ghost_points(ping, cell_m)])

    bins = polar_bins(points.sonar_m, ping.window, ping.sonar)
    in_window = bins >= 0
    ahead_m, left_m, up_m = points.sonar_m[:, in_window]
    range_m = np.sqrt(ahead_m * ahead_m + left_m * left_m + up_m * up_m)
    echoes = PointEchoes(
        bins[in_window],
        np.sqrt(points.powers[in_window]),
        points.cells[in_window],
        np.empty(0, np.float32),
        _two_way_phases(range_m, ping),
    )
    return scattered(ping, rng, looks, echoes)


def _two_way_phases(range_m: Float64s, ping: Ping) -> UInt16s:
    """Return the phase of the path to each range and back, (N,) uint16 65536ths of a turn."""
    wavelengths_per_m = 2000 * ping.sonar.frequency_khz / ping.water.sound_speed_m_s()
    turns = range_m * wavelengths_per_m
    fraction = turns - np.floor(turns)
    return np.asarray(fraction * 65536.0).astype(np.uint16)


def _join(parts: list[CellPoints]) -> CellPoints:
    """Return the points of all parts as one record."""
    if len(parts) == 1:
        return parts[0]
    return CellPoints(
        np.concatenate([part.cells for part in parts]),
        np.concatenate([part.powers for part in parts]),
        np.concatenate([part.sonar_m for part in parts], axis=1),
    )


def _place_moving_points(ping: Ping, cell_m: float) -> list[CellPoints]:
    """Return for each moving object the cells of its own axes as one point each.

    The points move, turn and bend with the object; see `MovingScatterers`.
    """
    points_by_object = []
    for moving in ping.scatterers.moving:
        points = moving.points(ping.scatterers.powers[moving.index], cell_m)
        sonar_m = ping.sonar.mount.in_sonar_axes(points.camera_m).T
        points_by_object.append(CellPoints(points.names, points.powers, sonar_m))
    return points_by_object


def _place_ghost_points(ping: Ping, cell_m: float) -> list[CellPoints]:
    """Return the cells of mirror images as one point each; see `GhostScatterers`."""
    ghosts = ping.scatterers.ghosts
    if ghosts is None:
        return []
    points = ghosts.points(cell_m)
    return [CellPoints(points.names, points.powers, points.sonar_m)]


def _place_static_points(ping: Ping, cell_m: float) -> CellPoints:
    """Return the cells of the static scene as one point each, at a random place of the cell.

    Raises FrameError when there are too many cells.
    """
    from ..imaging import kernels  # loads numba

    scene = ping.scatterers
    world_from_camera = np.ascontiguousarray(scene.world_from_camera[:3])
    static = static_index(scene.moving, len(scene.pixels))
    gather_arguments = (
        (scene.pixels[static], scene.parts[static]),
        scene.powers[static],
        tuple(camera_rays(scene.frame)),
        world_from_camera,
        cell_m,
    )
    # With a table of no slots the loop only counts.
    point_count = kernels.gather(*gather_arguments, _cell_table(0))
    if point_count > _MOST_POINTS:
        raise FrameError(
            f"{scene.frame.ref.name}: {point_count} points for cells of {1000 * cell_m:.2g} mm; "
            "set noise.path_speckle.scatterer_m to larger ones"
        )
    slots = 1 << int(point_count).bit_length()
    table = _cell_table(slots)
    kernels.gather(*gather_arguments, table)

    names, all_powers, corners = table
    has_echo = np.flatnonzero(all_powers > 0)
    cells = names[has_echo]
    x, y, z = (corners[has_echo].T + places_in_cells(cells)) * cell_m
    mount = ping.sonar.mount
    sonar_from_camera = mount.rotation_sonar_from_camera()
    sonar_from_world = sonar_from_camera @ np.linalg.inv(scene.world_from_camera)[:3]
    sonar_from_world[:, 3] -= sonar_from_camera @ mount.position_camera_m()
    # Spelled out, for a matrix product of many points may round differently on other processors.
    sonar_m = [row[0] * x + row[1] * y + row[2] * z + row[3] for row in sonar_from_world]
    return CellPoints(cells, all_powers[has_echo], np.stack(sonar_m))


def _cell_table(slots: int) -> tuple[UInt32s, Float32s, Int32s]:
    """Return an empty hash table as `kernels.gather` fills it: names, powers, cell corners."""
    names = np.zeros(slots, np.uint32)
    powers = np.zeros(slots, np.float32)
    return names, powers, np.empty((slots, 3), np.int32)


def default_cell_m(ping: Ping) -> float:
    """Return the edge of a cell that suits the device's resolution, a power of two, metres."""
    # A cell is one point in one bin here and loses no power: the coarser of both lengths will do.
    length_m = max(ping.bin_m, ping.resolution_m)
    width_m = _CELL_WIDE_FROM * ping.window.range_max_m * array.beam_width_sine(ping.sonar.array)
    return float(2.0 ** np.floor(np.log2(min(length_m, width_m))))


PATH_SPECKLE = Effect(
    PathSpeckleSettings,
    path_speckle,
    stage="echo",
    artefact="speckle",
    scope="world",
    expected=expect_speckle,
)
