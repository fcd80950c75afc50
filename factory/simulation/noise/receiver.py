"""The noise of the receiver."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Decibels
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping, add_white_noise, beamform, white_noise


@dataclass(frozen=True, config=STRICT)
class ReceiverSettings(EffectSettings):
    """Keys of `noise.receiver`.

    level_db: above the thermal noise of the sea in the device's band and beam, dB.
    grain: sample (each bin and beam for itself: a lens, an element a beam) or beam (through the
        beamformer and the pulse compression, with the grain of speckle).
    """

    level_db: Decibels = parameter(10, "dB")
    grain: Literal["sample", "beam"] = parameter("sample")


def receiver(field: Float32s, ping: Ping, rng: Rng, *, level_db: float, grain: str) -> Float32s:
    """The sea's thermal noise (Mellen 1952) and what the electronics add.

    Complex Gaussian, so Rayleigh in amplitude, and equally strong at all ranges before time-varying
    gain.  How far echoes stand above it does not depend on the sampling (`Ping.noise_share`).
    """
    across = np.sqrt(_floor(ping, level_db)).astype(np.float32)
    if grain == "beam":
        noise = beamform(white_noise(rng, field.shape[0], ping.shape), ping)
        noise *= across
        noise += field
        return noise
    add_white_noise(field, rng, np.ones(ping.shape[0], np.float32), across)
    return field


def _floor(ping: Ping, level_db: float) -> npt.NDArray[np.floating]:
    """(beams,) intensity of the noise."""
    return np.asarray(ping.thermal_noise * 10 ** (level_db / 10) * ping.noise_share)


def expect_receiver(state: Expected, ping: Ping, rng: Rng, *, level_db: float, grain: str) -> None:
    """The floor that the noise gives the image."""
    state.noise += _floor(ping, level_db).astype(np.float32)


RECEIVER = Effect(ReceiverSettings, receiver, "beam", "haze", systematic=expect_receiver)
