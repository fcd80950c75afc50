"""Spokes: single bearings that are too loud at all ranges, from other sonars and propellers."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from simnfnd.factory.distribution import AnyNumber, NonNegative
from simnfnd.factory.formation.field.signal import Floats, Ping
from simnfnd.factory.noise.effect import Effect, EffectSettings, parameter
from simnfnd.factory.settings import STRICT

# Beyond so many widths a spoke is not there.
_REACH = 4


@dataclass(frozen=True, config=STRICT)
class SpokesSettings(EffectSettings):
    """Keys of `noise.spokes`.

    count: number of spokes (rounded).
    level_db: of a spoke's noise against full scale, dB (negative).
    width_beams: its width, one standard deviation, beams.
    """

    count: NonNegative = parameter(1, "1")
    level_db: AnyNumber = parameter(-25, "dB")
    width_beams: NonNegative = parameter(0.7, "1")


def spokes(
    field: Floats,
    ping: Ping,
    rng: np.random.Generator,
    *,
    count: float,
    level_db: float,
    width_beams: float,
) -> Floats:
    """The field with noise added around random bearings."""
    rows, beams = ping.shape
    width = max(width_beams, 0.1)
    for _ in range(round(count)):
        centre = rng.random() * beams
        first = max(int(centre - _REACH * width), 0)
        last = min(int(centre + _REACH * width) + 1, beams)
        away = (np.arange(first, last) + 0.5 - centre) / width
        amplitude = np.sqrt(ping.full_scale / 2) * 10 ** (level_db / 20) * np.exp(-(away**2) / 4)
        noise = rng.standard_normal((*field.shape[:2], rows, last - first), dtype=np.float32)
        field[..., first:last] += noise * amplitude.astype(np.float32)
    return field


SPOKES = Effect(SpokesSettings, spokes, "picture")
