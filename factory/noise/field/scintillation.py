"""Scintillation: every sample's level trembles from ping to ping, whatever its level is.

Recordings of a scene at rest show it: part of the speckle stands still, and what changes is nearly
Gaussian on a logarithmic display and about as strong in bright bins as in dark ones
(docs/denoising.md has the figures of three recordings).  Here the intensity of each sample is
multiplied by a log-normal number whose median is 1.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT

_NEPERS_PER_DB = np.log(10) / 10  # of intensity


@dataclass(frozen=True, config=STRICT)
class ScintillationSettings(EffectSettings):
    """Keys of `noise.scintillation`.

    sigma_db: standard deviation of a sample's level, dB.
    """

    sigma_db: NonNegative = parameter(3, "dB")


def scintillation(
    field: Floats, ping: Ping, rng: np.random.Generator, *, sigma_db: float
) -> Floats:
    """The field, every sample weakened or strengthened."""
    level_nepers = rng.standard_normal(field.shape[-2:], np.float32)
    level_nepers *= np.float32(sigma_db * _NEPERS_PER_DB / 2)  # of amplitude
    field *= np.exp(level_nepers, out=level_nepers)
    return field


def expect_scintillation(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, sigma_db: float
) -> None:
    """A display of levels shows the median; one of powers shows a little more."""
    expected.scintillation_nepers2 += (sigma_db * _NEPERS_PER_DB) ** 2


SCINTILLATION = Effect(
    ScintillationSettings,
    scintillation,
    "picture",
    expected=expect_scintillation,
    artefact="speckle",
)
