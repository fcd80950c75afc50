"""Receiver noise: the sea's thermal noise (Mellen 1952) and what the electronics add.

Complex Gaussian, so Rayleigh in amplitude, and equally strong at all ranges; time-varying gain,
which comes after, makes it grow with range.  How far echoes stand above it does not depend on how
finely the device samples range and bearing (`Ping.noise_share`).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping, add_white_noise, beamform, white_noise
from ...imaging.effect import Effect, EffectSettings, option, parameter
from ...settings import STRICT


@dataclass(frozen=True, config=STRICT)
class ReceiverSettings(EffectSettings):
    """Keys of `noise.receiver`.

    level_db: above the thermal noise of the sea in the device's band and beam, dB.
    grain: sample (each bin and beam for itself: a lens, an element a beam) or beam (through the
        beamformer and the pulse compression, with the grain of speckle).
    """

    level_db: AnyNumber = parameter(10, "dB")
    grain: Literal["sample", "beam"] = option("sample")


def receiver(
    field: Floats, ping: Ping, rng: np.random.Generator, *, level_db: float, grain: str
) -> Floats:
    """The field with the receiver's noise."""
    amplitude = np.sqrt(ping.thermal_noise * 10 ** (level_db / 10) * ping.noise_share)
    across = amplitude.astype(np.float32)
    if grain == "beam":
        noise = beamform(white_noise(rng, field.shape[0], ping.shape), ping)
        noise *= across
        noise += field
        return noise
    add_white_noise(field, rng, np.ones(ping.shape[0], np.float32), across)
    return field


def expect_receiver(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, level_db: float, grain: str
) -> None:
    """The floor that the noise gives the picture."""
    floor = ping.thermal_noise * 10 ** (level_db / 10) * ping.noise_share
    expected.noise += floor.astype(np.float32)


RECEIVER = Effect(
    ReceiverSettings, receiver, "beam", systematic=True, expected=expect_receiver, artefact="haze"
)
