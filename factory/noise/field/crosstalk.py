"""Crosstalk: channels that are read out side by side leak into each other."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from simnfnd.factory.distribution import AnyNumber, Positive
from simnfnd.factory.formation.field.signal import Floats, Ping
from simnfnd.factory.noise.effect import Effect, EffectSettings, parameter
from simnfnd.factory.settings import STRICT


@dataclass(frozen=True, config=STRICT)
class CrosstalkSettings(EffectSettings):
    """Keys of `noise.crosstalk`.

    level_db: of the leak below the channel it comes from, dB (negative).
    spacing_beams: distance between channels that leak (rounded); devices that make their beams in
        several pings leak among those of one ping.
    """

    level_db: AnyNumber = parameter(-35, "dB")
    spacing_beams: Positive = parameter(1, "1")


def crosstalk(
    field: Floats,
    ping: Ping,
    rng: np.random.Generator,
    *,
    level_db: float,
    spacing_beams: float,
) -> Floats:
    """The field with what leaks from `spacing_beams` to the left and to the right."""
    from simnfnd.factory.formation.field import kernels  # loads numba

    kernels.beside(field, max(round(spacing_beams), 1), 10 ** (level_db / 20))
    return field


CROSSTALK = Effect(CrosstalkSettings, crosstalk, "beam")
