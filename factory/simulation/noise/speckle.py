"""Fully developed speckle of the complex field."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.distribution import Looks
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping, Signal, beamform, scattered


@dataclass(frozen=True, config=STRICT)
class SpeckleSettings(EffectSettings):
    """Keys of `noise.speckle`.

    looks: independent fields whose intensities are averaged (rounded); 1 is Rayleigh speckle.
    """

    looks: Looks = parameter(1, "1")


def speckle(signal: Signal, ping: Ping, rng: Rng, *, looks: float) -> Signal:
    """The complex field of the scene's points instead of the mean power of the echoes.

    Every point has a complex circular Gaussian coefficient that depends on its cell of the world
    alone, and the device's point-spread gives the field its grain: fully developed, amplitude
    Rayleigh, intensity exponential (Goodman, Speckle Phenomena in Optics, ch. 3); the average of L
    looks is gamma-distributed, L its shape.  Without poses every frame has a field of its own.
    """
    return scattered(ping, rng, looks, ping.grain)


def expect_speckle(state: Expected, ping: Ping, rng: Rng, *, looks: float) -> None:
    """Split the expected power into speckle that averages out over pings and speckle that stays.

    The field of a ping is sqrt(p) F + sqrt(1 - p) G, with p = `standing`.  F is the same in every
    ping and G is drawn anew, so a mean of pings keeps the speckle of F and only the mean power of
    G: the part 1 - p of the power moves from `steady` to `echo`, and `steady` becomes the intensity
    of sqrt(p) F.

    The noisy image of this pair shows one such sum, S, and F is to be what lies in it.  S and F are
    Gaussian with the same variance and the correlation sqrt(p).  F given S is therefore
    sqrt(p) S + sqrt(1 - p) H, with H independent of S.
    """
    static_part = state.standing
    state.echo += (1 - static_part) * state.steady
    state.steady[:] = 0
    state.looks = max(round(looks), 1)
    if static_part == 0:
        return

    # The effect's random stream gives the noisy image its field first, so S is the first draw.
    noisy_field = scattered(ping, rng, looks, ping.grain).field
    independent_field = scattered(ping, rng, looks, ping.grain).field
    static_field = np.float32(np.sqrt(static_part)) * noisy_field
    static_field += np.float32(np.sqrt(1 - static_part)) * independent_field
    intensity = (beamform(static_field, ping) ** 2).sum(axis=1).mean(axis=0)
    state.steady[:] = static_part * intensity


SPECKLE = Effect(
    SpeckleSettings,
    speckle,
    stage="echo",
    artefact="speckle",
    scope="world",
    expected=expect_speckle,
)
