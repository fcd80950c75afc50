"""Speckle of a sonar that moves: every echo has the phase of the way there and back.

As `speckle`, and the cells of the world are points whose echoes turn with their range.  A sonar at
rest sees the same speckle, to the byte; one that moves across loses it over about half its
aperture, one that turns or moves along keeps it for longer (Goodman, Speckle Phenomena in Optics,
ch. 5).  Needs frames with poses, of a range window that stays the same (sonar.range.auto=false).
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative, Positive
from ...imaging.coherent.path_cells import edge_m, path_cells
from ...imaging.coherent.signal import Ping, Signal, scattered
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT
from .speckle import expect_speckle


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
    """The field of the cells instead of the mean power of the echoes."""
    cells = path_cells(ping, scatterer_m or edge_m(ping))
    points = (cells.bins, cells.roots, cells.names)
    return scattered(ping, rng, looks, points, phases=cells.phases)


PATH_SPECKLE = Effect(
    PathSpeckleSettings,
    path_speckle,
    "echo",
    "world",
    expected=expect_speckle,
    artefact="speckle",
)
