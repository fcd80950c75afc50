"""Scintillation: the level of every sample varies from ping to ping."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Distribution, as_written, within
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping

_NEPERS_PER_DB = np.log(10) / 10  # of intensity


@dataclass(frozen=True, config=STRICT)
class ScintillationSettings(EffectSettings):
    """Keys of `noise.scintillation`.

    sigma_db: standard deviation of a sample's level, dB.
    """

    sigma_db: Annotated[Distribution, within(0, 40, "dB"), as_written] = parameter(3, "dB")


def scintillation(field: Float32s, ping: Ping, rng: Rng, *, sigma_db: float) -> Float32s:
    """Vary every sample's level from ping to ping, as much in bright bins as in dark ones.

    In recordings of a static scene the changes are nearly Gaussian on a logarithmic display.  Here
    each intensity gets a log-normal factor, median 1.
    """
    level_nepers = rng.standard_normal(field.shape[-2:], np.float32)
    level_nepers *= np.float32(sigma_db * _NEPERS_PER_DB / 2)  # of amplitude
    field *= np.exp(level_nepers, out=level_nepers)
    return field


def expect_scintillation(state: Expected, ping: Ping, rng: Rng, *, sigma_db: float) -> None:
    """Add the variance of the log-intensity.

    A logarithmic display shows the median of the fluctuation, one of powers slightly more.
    """
    state.scintillation_nepers2 += (sigma_db * _NEPERS_PER_DB) ** 2


SCINTILLATION = Effect(
    ScintillationSettings,
    scintillation,
    stage="image",
    artefact="speckle",
    expected=expect_scintillation,
)
