"""Arcs: the strongest echo of a range in the sidelobes of all beams."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Decibels
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping


@dataclass(frozen=True, config=STRICT)
class SidelobeArcsSettings(EffectSettings):
    """Keys of `noise.sidelobe_arcs`.

    level_db: of the leak below the strongest return of the row, dB (negative).
    """

    level_db: Decibels = parameter(-30, "dB")


def sidelobe_arcs(field: Float32s, ping: Ping, rng: Rng, *, level_db: float) -> Float32s:
    """Leak the strongest return of each range row into all its beams, with one random phase a row.

    Beam patterns of `sonar.array` have the sidelobes of a perfect array.  Those of a real array do
    not fall below -20 to -35 dB of the strongest return at any bearing.
    """
    strongest_intensity = (field[:, 0] ** 2 + field[:, 1] ** 2).max(axis=-1)
    leak = np.sqrt(strongest_intensity) * np.float32(10 ** (level_db / 20))
    phase_rad = 2 * np.pi * rng.random(leak.shape, dtype=np.float32)
    arcs = np.stack([leak * np.cos(phase_rad), leak * np.sin(phase_rad)], axis=1)
    field += arcs[..., None]
    return field


def expect_sidelobe_arcs(state: Expected, ping: Ping, rng: Rng, *, level_db: float) -> None:
    """Add the expected leak of each row to the steady intensity, in place.

    The strongest of n independent exponential values is on average 1 + 1/2 + ... + 1/n times their
    mean.  n is the number of resolution cells over which the intensity of a row is spread.
    """
    total = state.total()
    strongest = total.max(axis=1)
    nonzero_strongest = np.maximum(strongest, 1e-37)
    beams_per_cell = max(float(1 / np.median(ping.beam_share)), 1)
    cell_count = np.maximum(total.sum(axis=1) / nonzero_strongest / beams_per_cell, 1)

    # The harmonic number of the cell count less 1, within 0.1.
    excess_of_maximum = np.log(cell_count) - 0.423 * (1 - np.exp(1 - cell_count))
    fluctuating_part = 1 - state.steady.max(axis=1) / nonzero_strongest
    leak = strongest * (1 + excess_of_maximum * np.clip(fluctuating_part, 0, 1))
    state.steady += (leak * 10 ** (level_db / 10)).astype(np.float32)[:, None]


SIDELOBE_ARCS = Effect(
    SidelobeArcsSettings, sidelobe_arcs, "beam", "ghosts", systematic=expect_sidelobe_arcs
)
