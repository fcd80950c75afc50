"""Saturation: the receiver's converter has a largest number, before any gain in software."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from simnfnd.factory.distribution import AnyNumber
from simnfnd.factory.formation.field.signal import Floats, Ping
from simnfnd.factory.noise.effect import Effect, EffectSettings, parameter
from simnfnd.factory.settings import STRICT


@dataclass(frozen=True, config=STRICT)
class SaturationSettings(EffectSettings):
    """Keys of `noise.saturation`.

    level_db: largest amplitude against the strongest expected echo of the frame, before
        time-varying gain, dB.
    """

    level_db: AnyNumber = parameter(3, "dB")


def saturation(field: Floats, ping: Ping, rng: np.random.Generator, *, level_db: float) -> Floats:
    """The field, no amplitude above the limit."""
    from simnfnd.factory.formation.field import kernels  # loads numba

    limit = (ping.strongest * 10 ** (level_db / 10) * ping.gain).astype(np.float32)
    kernels.saturate(field, limit)
    return field


SATURATION = Effect(SaturationSettings, saturation, "picture")
