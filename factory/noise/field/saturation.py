"""Saturation: the receiver's converter has a largest number, before any gain in software."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT


@dataclass(frozen=True, config=STRICT)
class SaturationSettings(EffectSettings):
    """Keys of `noise.saturation`.

    level_db: largest amplitude against the strongest expected echo of the frame, before
        time-varying gain, dB.
    """

    level_db: AnyNumber = parameter(3, "dB")


def saturation(field: Floats, ping: Ping, rng: np.random.Generator, *, level_db: float) -> Floats:
    """The field, no amplitude above the limit."""
    limit = _limit(ping, level_db)[:, None]
    for real, imaginary in field:
        intensity = real * real + imaginary * imaginary
        factor = np.ones_like(intensity)
        np.divide(limit, intensity, out=factor, where=intensity > limit)
        np.sqrt(factor, out=factor)
        real *= factor
        imaginary *= factor
    return field


def expect_saturation(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, level_db: float
) -> None:
    """No expected intensity above the limit; single values above it are not taken from the mean."""
    limit = _limit(ping, level_db)[:, None]
    total = expected.total()
    if (total > limit).any():
        expected.scale(np.minimum(limit / np.maximum(total, 1e-37), 1))


def _limit(ping: Ping, level_db: float) -> Floats:
    """(range_bins,) largest intensity after time-varying gain."""
    return np.asarray(ping.strongest * 10 ** (level_db / 10) * ping.gain, np.float32)


SATURATION = Effect(
    SaturationSettings,
    saturation,
    "picture",
    systematic=True,
    expected=expect_saturation,
    artefact="gains",
)
