"""Volume reverberation with a memory: haze that changes slowly and drifts with the water."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Decibels, Distribution, as_written, within
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping, Signal, gaussian_table
from .volume import expect_volume, haze_intensity

_GOLDEN = 0x9E3779B9


@dataclass(frozen=True, config=STRICT)
class DriftingVolumeSettings(EffectSettings):
    """Keys of `noise.drifting_volume`.

    strength_db: volume scattering strength, dB re 1/m; clear water -70, a harbour -45.
    correlation_s: time over which the haze is replaced by another, seconds.
    drift_m_s: how fast it moves away from the sonar, m/s.
    """

    strength_db: Decibels = parameter(-60, "dB")
    correlation_s: Annotated[Distribution, within(1e-3, 1e5, "s"), as_written] = parameter(1, "s")
    drift_m_s: Annotated[Distribution, within(-30, 30, "m/s"), as_written] = parameter(0, "m/s")


def drifting_volume(
    signal: Signal,
    ping: Ping,
    rng: Rng,
    *,
    strength_db: float,
    correlation_s: float,
    drift_m_s: float,
) -> Signal:
    """Volume reverberation that is a function of the time within its recording.

    Independent fields stand at times `correlation_s` apart; between two of them the haze is their
    sum, weighted by a cosine and a sine, so its intensity stays and its correlation falls to 1 / pi
    after that time and to 0 after twice the time.  A frame without a time is at time 0.
    """
    along, across = haze_intensity(ping, strength_db)
    time_s = ping.surface.frame.time_s or 0.0
    first_key = int(rng.integers(2**32))
    step = time_s / correlation_s + float(rng.random())
    angle = np.pi / 2 * (step - np.floor(step))
    shift = round(drift_m_s * time_s / ping.bin_m)
    amplitude = np.sqrt(along)[:, None] * np.sqrt(across)
    for look_number, look in enumerate(signal.field):
        for number, weight in ((0, np.cos(angle)), (1, np.sin(angle))):
            key = first_key + _GOLDEN * (int(np.floor(step)) + number) + look_number
            planes = _white(ping, key % 2**32)
            look += np.float32(weight) * amplitude * np.roll(planes, shift, axis=1)
    return signal


def _white(ping: Ping, key: int) -> Float32s:
    """(2, range_bins, beams) complex circular Gaussian noise of intensity 1."""
    from ..imaging import kernels  # loads numba

    planes = np.zeros((2, *ping.shape), np.float32)
    rows, beams = (np.ones(side, np.float32) for side in ping.shape)
    (mixed,) = kernels.scrambled(np.array([key], np.uint32))
    kernels.add_white(int(mixed), gaussian_table(), rows, beams, planes)
    return planes


def expect_drifting_volume(
    state: Expected,
    ping: Ping,
    rng: Rng,
    *,
    strength_db: float,
    correlation_s: float,
    drift_m_s: float,
) -> None:
    """Add the expected intensity of the haze."""
    expect_volume(state, ping, rng, strength_db=strength_db)


DRIFTING_VOLUME = Effect(
    DriftingVolumeSettings,
    drifting_volume,
    "echo",
    "haze",
    "recording",
    systematic=expect_drifting_volume,
)
