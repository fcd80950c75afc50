"""Speckle of a sonar that moves: every echo has the phase of the way there and back.

As `speckle`, and the cells of the world are points whose echoes turn with their range: when the
sonar moves, the cells of a bin come nearer by different parts of a wavelength, and their sum
changes.  A sonar at rest sees the same speckle, to the byte; one that moves across loses it over
about half its aperture, long before other cells lie in the bin; one that turns or moves along keeps
it for longer (Goodman, Speckle Phenomena in Optics, ch. 5).  Needs frames with poses, of a range
window that stays the same (sonar.range.auto=false).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative, Positive
from ...errors import FrameError
from ...imaging.coherent.scatterers import camera_of, grid_of
from ...imaging.coherent.signal import Ping, Signal, scattered
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT
from ...sonar import array
from .speckle import expect_speckle

_MOST_POINTS = 1 << 25
# Where a beam is to be at least a cell wide, as a part of the farthest range.
_NEAR = 0.25


@dataclass(frozen=True, config=STRICT)
class PathSpeckleSettings(EffectSettings):
    """Keys of `noise.path_speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    scatterer_m: edge of a world cell, metres; 0 takes about what the device tells apart.
    """

    looks: Positive = parameter(1, "1")
    scatterer_m: NonNegative = parameter(0, "m")


def path_speckle(
    signal: Signal, ping: Ping, rng: np.random.Generator, *, looks: float, scatterer_m: float
) -> Signal:
    """The field of the cells instead of the mean power of the echoes.

    Raises FrameError when the cells are too many.
    """
    from ...imaging.coherent import kernels  # loads numba

    scene, cell_m = ping.scatterers, scatterer_m or edge_m(ping)
    pose = np.ascontiguousarray(scene.world_from_camera[:3])
    given = ((scene.pixels, scene.parts), scene.powers, camera_of(scene.frame), pose, cell_m)
    nothing = np.empty(0, np.uint32), np.empty(0, np.float32), np.empty((0, 3), np.int32)
    points = kernels.gather(*given, nothing)
    if points > _MOST_POINTS:
        raise FrameError(
            f"{scene.frame.ref.name}: {points} points for cells of {1000 * cell_m:.2g} mm; set "
            "noise.path_speckle.scatterer_m to larger ones"
        )
    slots = 1 << int(points).bit_length()
    names, powers = np.zeros(slots, np.uint32), np.zeros(slots, np.float32)
    table = names, powers, np.empty((slots, 3), np.int32)
    kernels.gather(*given, table)
    cells = int(np.count_nonzero(names))
    found: tuple[Any, ...] = tuple(
        np.empty(cells, kind) for kind in (np.int32, np.float32, np.uint32, np.uint16)
    )
    waves_per_m = 2000 * ping.sonar.frequency_khz / ping.water.sound_speed_m_s()
    grid = grid_of(ping.window, ping.sonar)
    count = kernels.locate(table, cell_m, _sonar_from_world(ping), grid, waves_per_m, found)
    bins, roots, kept, phases = (values[:count] for values in found)
    return scattered(ping, rng, looks, (bins, roots, kept), phases=phases)


def edge_m(ping: Ping) -> float:
    """Edge of a cell that suits the device, a power of two, metres: what the device tells apart."""
    length_m = max(ping.bin_m, ping.resolution_m)
    width_m = _NEAR * ping.window.range_max_m * array.beam_width_sine(ping.sonar.array)
    return float(2.0 ** np.floor(np.log2(min(length_m, width_m))))


def _sonar_from_world(ping: Ping) -> npt.NDArray[np.float64]:
    """(3, 4): world axes to sonar axes (x forward, y left, z up)."""
    camera_from_world = np.linalg.inv(ping.scatterers.world_from_camera)
    mount = ping.sonar.mount
    turn = mount.rotation_sonar_from_camera()
    made = turn @ camera_from_world[:3]
    made[:, 3] -= turn @ mount.position_camera_m()
    return np.ascontiguousarray(made)


PATH_SPECKLE = Effect(
    PathSpeckleSettings, path_speckle, "echo", "world", expected=expect_speckle, artefact="speckle"
)
