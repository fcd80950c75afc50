"""Speckle of a moving sonar: the phase of every echo follows from its path."""

from __future__ import annotations

from pydantic.dataclasses import dataclass

from ...common.distribution import Looks
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.signal import Ping, Signal, scattered
from .speckle import expect_speckle


@dataclass(frozen=True, config=STRICT)
class PathSpeckleSettings(EffectSettings):
    """Keys of `noise.path_speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    """

    looks: Looks = parameter(1, "1")


def path_speckle(signal: Signal, ping: Ping, rng: Rng, *, looks: float) -> Signal:
    """Speckle of the same points, whose echoes turn in phase with their range.

    A sonar at rest sees the same speckle in every frame, to the byte.  One that moves across its
    view loses the speckle over about half its aperture; one that turns or moves along its view
    keeps it for longer (Goodman, ch. 5).  Needs frames with poses, and a range window that stays
    the same (sonar.range.auto=false).
    """
    return scattered(ping, rng, looks, ping.phased_grain)


PATH_SPECKLE = Effect(
    PathSpeckleSettings,
    path_speckle,
    stage="echo",
    artefact="speckle",
    scope="world",
    expected=expect_speckle,
)
