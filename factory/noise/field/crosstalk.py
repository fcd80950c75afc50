"""Crosstalk: channels that are read out side by side leak into each other."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber, Positive
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping, sounds
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT


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
    field: Floats, ping: Ping, rng: np.random.Generator, *, level_db: float, spacing_beams: float
) -> Floats:
    """The field with what leaks from `spacing_beams` to the left and to the right."""
    step, leaks = max(round(spacing_beams), 1), np.float32(10 ** (level_db / 20)) * field
    field[..., step:] += leaks[..., :-step]
    field[..., :-step] += leaks[..., step:]
    return field


def expect_crosstalk(
    expected: Expected,
    ping: Ping,
    rng: np.random.Generator,
    *,
    level_db: float,
    spacing_beams: float,
) -> None:
    """Intensities of the leaks, and what they add in phase: beams that overlap are alike."""
    from ...imaging.coherent import kernels  # loads numba

    leak, step = 10 ** (level_db / 20), max(round(spacing_beams), 1)
    alike = _alike(ping, step)
    for plane, correlation in (
        (expected.echo, alike),
        (expected.noise, 0.0),
        (expected.steady, 1.0),
        (expected.textured, alike),
    ):
        if sounds(plane):
            kernels.leaked(plane, step, leak, correlation)


def _alike(ping: Ping, step: int) -> float:
    """Correlation of the field in two beams that are so many apart, in the middle."""
    middle = ping.sonar.beams // 2
    if middle + step >= ping.sonar.beams:
        return 0.0
    one, other = (ping.mixing[:, beam].astype(np.float64) for beam in (middle, middle + step))
    return float(one @ other / np.sqrt((one @ one) * (other @ other)))


CROSSTALK = Effect(
    CrosstalkSettings,
    crosstalk,
    "beam",
    systematic=True,
    expected=expect_crosstalk,
    artefact="haze",
)
