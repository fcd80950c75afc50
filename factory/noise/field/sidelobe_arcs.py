"""Sidelobe arcs: a strong return leaks into every beam of its range row.

Beam patterns of `sonar.array` have the sidelobes of a perfect array; those of a real one do not
fall below -20 to -35 dB of the strongest return, whatever the bearing.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT


@dataclass(frozen=True, config=STRICT)
class SidelobeArcsSettings(EffectSettings):
    """Keys of `noise.sidelobe_arcs`.

    level_db: of the leak below the strongest return of the row, dB (negative).
    """

    level_db: AnyNumber = parameter(-30, "dB")


def sidelobe_arcs(
    field: Floats, ping: Ping, rng: np.random.Generator, *, level_db: float
) -> Floats:
    """The field with each row's leak, of one random phase a row."""
    strongest = (field[:, 0] ** 2 + field[:, 1] ** 2).max(axis=-1)
    leak = np.sqrt(strongest) * np.float32(10 ** (level_db / 20))
    phase = 2 * np.pi * rng.random(leak.shape, dtype=np.float32)
    arcs = np.stack([leak * np.cos(phase), leak * np.sin(phase)], axis=1)
    field += arcs[..., None]
    return field


def expect_sidelobe_arcs(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, level_db: float
) -> None:
    """The leak of each row, which has one phase in all beams.

    The strongest of n independent exponential values is 1 + 1/2 + ... + 1/n of their mean; a row
    has as many as its intensity is spread over, in steps of what the device resolves.
    """
    total = expected.total()
    strongest = total.max(axis=1)
    beams_wide = max(float(1 / np.median(ping.beam_share)), 1)
    independent = total.sum(axis=1) / np.maximum(strongest, 1e-37) / beams_wide
    count = np.maximum(independent, 1)
    # Harmonic numbers less 1, within 0.1.
    more = np.log(count) - 0.423 * (1 - np.exp(1 - count))
    fluctuating = 1 - expected.steady.max(axis=1) / np.maximum(strongest, 1e-37)
    leak = strongest * (1 + more * np.clip(fluctuating, 0, 1))
    expected.steady += (leak * 10 ** (level_db / 10)).astype(np.float32)[:, None]


SIDELOBE_ARCS = Effect(
    SidelobeArcsSettings,
    sidelobe_arcs,
    "beam",
    systematic=True,
    expected=expect_sidelobe_arcs,
    artefact="ghosts",
)
