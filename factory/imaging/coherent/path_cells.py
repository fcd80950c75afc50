"""Cells of the world as scatterers whose echoes have the phase of the way there and back.

A cell is a point of its own in the world.  When the sonar moves, the cells of a bin come nearer by
different parts of a wavelength, and the sum of their echoes changes: the field of a beam of an
aperture L is another after about L / 2 of movement across, long before other cells lie in the bin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...errors import FrameError
from ...sonar import array
from ..contract import Floats
from .scatterers import camera_of, grid_of
from .signal import Ping

MOST_POINTS = 1 << 25
# Where a beam is to be at least a cell wide, as a part of the farthest range.
_NEAR = 0.25


@dataclass(frozen=True, eq=False)
class PathCells:
    """N cells that lie in the picture.

    bins: (N,) int32 flat polar bin.  roots: (N,) float32 root of the power, without absorption.
    names: (N,) uint32, the cell.  phases: (N,) uint16 of the two-way path, 65536 to a turn.
    """

    bins: npt.NDArray[np.int32]
    roots: Floats
    names: npt.NDArray[np.uint32]
    phases: npt.NDArray[np.uint16]


def edge_m(ping: Ping) -> float:
    """Edge of a cell that suits the device, a power of two, metres: what the device tells apart."""
    length_m = max(ping.bin_m, ping.resolution_m)
    width_m = _NEAR * ping.window.range_max_m * array.beam_width_sine(ping.sonar.array)
    return float(2.0 ** np.floor(np.log2(min(length_m, width_m))))


def path_cells(ping: Ping, cell_m: float) -> PathCells:
    """The cells in which the scatterers of a ping lie.

    Raises FrameError when they are too many.
    """
    from . import kernels  # loads numba

    scene = ping.scatterers
    pose = np.ascontiguousarray(scene.world_from_camera[:3])
    given = ((scene.pixels, scene.parts), scene.powers, camera_of(scene.frame), pose, cell_m)
    nothing = np.empty(0, np.uint32), np.empty(0, np.float32), np.empty((0, 3), np.int32)
    points = kernels.gather(*given, nothing)
    if points > MOST_POINTS:
        raise FrameError(
            f"{scene.frame.ref.name}: {points} points for cells of {1000 * cell_m:.2g} mm; set "
            "noise.path_speckle.scatterer_m to larger ones"
        )
    slots = 1 << int(points).bit_length()
    names, powers = np.zeros(slots, np.uint32), np.zeros(slots, np.float32)
    table = names, powers, np.empty((slots, 3), np.int32)
    kernels.gather(*given, table)
    cells = int(np.count_nonzero(names))
    found = tuple(np.empty(cells, kind) for kind in (np.int32, np.float32, np.uint32, np.uint16))
    waves_per_m = 2000 * ping.sonar.frequency_khz / ping.water.sound_speed_m_s()
    grid = grid_of(ping.window, ping.sonar)
    count = kernels.locate(table, cell_m, _sonar_from_world(ping), grid, waves_per_m, found)
    return PathCells(*(values[:count] for values in found))


def _sonar_from_world(ping: Ping) -> npt.NDArray[np.float64]:
    """(3, 4): world axes to sonar axes (x forward, y left, z up)."""
    camera_from_world = np.linalg.inv(ping.scatterers.world_from_camera)
    mount = ping.sonar.mount
    turn = mount.rotation_sonar_from_camera()
    made = turn @ camera_from_world[:3]
    made[:, 3] -= turn @ mount.position_camera_m()
    return np.ascontiguousarray(made)
