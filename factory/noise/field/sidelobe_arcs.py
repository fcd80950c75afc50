"""Sidelobe arcs: a strong return leaks into every beam of its range row.

Beam patterns of `sonar.array` have the sidelobes of a perfect array; those of a real one do not
fall below -20 to -35 dB of the strongest return, whatever the bearing.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from simnfnd.factory.distribution import AnyNumber
from simnfnd.factory.formation.field.signal import Floats, Ping
from simnfnd.factory.noise.effect import Effect, EffectSettings, parameter
from simnfnd.factory.settings import STRICT


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
    from simnfnd.factory.formation.field import kernels  # loads numba

    strongest = np.empty((field.shape[0], field.shape[2]), np.float32)
    kernels.loudest(field, strongest)
    leak = np.sqrt(strongest) * np.float32(10 ** (level_db / 20))
    phase = 2 * np.pi * rng.random(leak.shape, dtype=np.float32)
    arcs = np.stack([leak * np.cos(phase), leak * np.sin(phase)], axis=1)
    field += arcs[..., None]
    return field


SIDELOBE_ARCS = Effect(SidelobeArcsSettings, sidelobe_arcs, "beam")
