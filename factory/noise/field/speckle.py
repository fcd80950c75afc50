"""Coherent speckle: the echoes of a rough surface add up with random phases.

Every scatterer gets a complex circular Gaussian coefficient that depends on its cell of the world
and on nothing of the frame.  The device's point-spread then filters the complex field, which gives
speckle its grain: fully developed, amplitude Rayleigh, intensity exponential (Goodman, Speckle
Phenomena in Optics, ch. 3).  The same scene from the same pose has the same speckle; a sonar that
moves sees other cells in each bin, and the speckle changes with it.  A recording without poses has
a field of its own in every frame.

The average of L looks is gamma-distributed, L being its shape.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative, Positive
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping, Signal, beamform, scattered
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT

# Edge of a world cell over what the device tells apart; power is then within 0.15 dB.
_CELL = 0.3


@dataclass(frozen=True, config=STRICT)
class SpeckleSettings(EffectSettings):
    """Keys of `noise.speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    scatterer_m: edge of a world cell, metres; 0 takes 0.3 of a range bin or of the resolution
        c / 2B, whichever is shorter.  A cell that reaches over several of them loses power and
        makes neighbouring bins alike.  Cells smaller than the camera's pixels lose their hold on
        the scene when the camera moves.
    """

    looks: Positive = parameter(1, "1")
    scatterer_m: NonNegative = parameter(0, "m")


def speckle(
    signal: Signal, ping: Ping, rng: np.random.Generator, *, looks: float, scatterer_m: float
) -> Signal:
    """The scatterers' complex field instead of the mean power of the echoes."""
    scene = ping.scatterers
    cells = scene.world_cells(scatterer_m or _CELL * min(ping.bin_m, ping.resolution_m))
    points = (scene.bins, np.sqrt(scene.powers), cells.names)
    return scattered(ping, rng, looks, points, cells.shares)


def expect_speckle(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, looks: float, scatterer_m: float
) -> None:
    """The echoes fluctuate, but for what stands still.

    A field that keeps the part p of its power from ping to ping is sqrt(p) f + sqrt(1 - p) g, f the
    same in all pings and g new in each.  This ping shows that sum, so f is, with another g,
    sqrt(p) (the sum) + sqrt(1 - p) g.
    """
    part = expected.standing
    expected.echo += (1 - part) * expected.steady
    if part:
        expected.steady[:] = part * _standing(ping, rng, part, looks, scatterer_m)
    else:
        expected.steady[:] = 0
    expected.looks = max(round(looks), 1)


def _standing(
    ping: Ping, rng: np.random.Generator, part: float, looks: float, scatterer_m: float
) -> Floats:
    """(range_bins, beams) intensity of f, whose mean is that of the echoes."""
    silent = Signal(np.zeros(ping.shape, np.float32), np.empty((0, 2, *ping.shape), np.float32))
    # The first has the stream of the effect, and so the field that the picture shows.
    shown, other = (
        speckle(silent, ping, rng, looks=looks, scatterer_m=scatterer_m).field for _ in range(2)
    )
    same = np.float32(np.sqrt(part)) * shown + np.float32(np.sqrt(1 - part)) * other
    return np.asarray((beamform(same, ping) ** 2).sum(axis=1).mean(axis=0), np.float32)


SPECKLE = Effect(
    SpeckleSettings, speckle, "echo", "world", expected=expect_speckle, artefact="speckle"
)
