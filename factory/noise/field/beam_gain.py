"""Channels that are not alike: every beam has a gain of its own, and some are dead.

They are the device's, so all frames of a recording have the same ones.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber, NonNegative
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping
from ...settings import STRICT
from ..effect import Effect, EffectSettings, parameter


@dataclass(frozen=True, config=STRICT)
class BeamGainSettings(EffectSettings):
    """Keys of `noise.beam_gain`.

    sigma_db: standard deviation of the gains, dB.
    dead: number of dead beams (rounded).  dead_db: their gain, dB.
    """

    sigma_db: NonNegative = parameter(0.5, "dB")
    dead: NonNegative = parameter(0, "1")
    dead_db: AnyNumber = parameter(-40, "dB")


def beam_gain(
    field: Floats,
    ping: Ping,
    rng: np.random.Generator,
    *,
    sigma_db: float,
    dead: float,
    dead_db: float,
) -> Floats:
    """The field under the gains of its beams."""
    gain_db = _gain_db(ping.sonar.beams, rng, sigma_db, dead, dead_db)
    field *= (10 ** (gain_db / 20)).astype(np.float32)
    return field


def expect_beam_gain(
    expected: Expected,
    ping: Ping,
    rng: np.random.Generator,
    *,
    sigma_db: float,
    dead: float,
    dead_db: float,
) -> None:
    """The intensities under the same gains."""
    expected.scale(10 ** (_gain_db(ping.sonar.beams, rng, sigma_db, dead, dead_db) / 10))


def _gain_db(
    beams: int, rng: np.random.Generator, sigma_db: float, dead: float, dead_db: float
) -> npt.NDArray[np.float64]:
    """(beams,) dB."""
    gain_db = sigma_db * rng.standard_normal(beams)
    gain_db[rng.permutation(beams)[: round(dead)]] = dead_db
    return gain_db


BEAM_GAIN = Effect(
    BeamGainSettings,
    beam_gain,
    "picture",
    "recording",
    systematic=True,
    expected=expect_beam_gain,
    artefact="gains",
)
