"""Saturation: the receiver clips strong echoes."""

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
class SaturationSettings(EffectSettings):
    """Keys of `noise.saturation`.

    level_db: largest amplitude against the strongest expected echo of the frame, before
        time-varying gain, dB.
    """

    level_db: Decibels = parameter(3, "dB")


def saturation(field: Float32s, ping: Ping, rng: Rng, *, level_db: float) -> Float32s:
    """No amplitude above the receiver's largest number, which it has before any gain."""
    limit = _limit(ping, level_db)
    intensity = (field**2).sum(axis=1)
    factor = np.ones_like(intensity)
    np.divide(limit, intensity, out=factor, where=intensity > limit)
    field *= np.sqrt(factor)[:, None]
    return field


def expect_saturation(state: Expected, ping: Ping, rng: Rng, *, level_db: float) -> None:
    """No expected intensity above the limit; single values above it are not taken from the mean."""
    limit = _limit(ping, level_db)
    total = state.total()
    if (total > limit).any():
        state.scale(np.minimum(limit / np.maximum(total, 1e-37), 1))


def _limit(ping: Ping, level_db: float) -> Float32s:
    """(range_bins, 1) largest intensity after time-varying gain."""
    limit = np.asarray(ping.strongest * 10 ** (level_db / 10) * ping.gain, np.float32)
    return limit[:, None]


SATURATION = Effect(SaturationSettings, saturation, "image", "gains", systematic=expect_saturation)
