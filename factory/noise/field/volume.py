"""Volume reverberation: the water's own scatterers, a haze behind and before everything.

A bin at range r has the volume r^2 theta phi dr; its echo is s_v V / r^4 without absorption
(Urick 1983, ch. 8).  The scatterers drift, so every frame has a haze of its own.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from simnfnd.factory.distribution import AnyNumber
from simnfnd.factory.formation.field.signal import Ping, Signal, add_white_noise
from simnfnd.factory.noise.effect import Effect, EffectSettings, parameter
from simnfnd.factory.settings import STRICT


@dataclass(frozen=True, config=STRICT)
class VolumeSettings(EffectSettings):
    """Keys of `noise.volume`.

    strength_db: volume scattering strength, dB re 1/m; clear water -70, a harbour -45.
    """

    strength_db: AnyNumber = parameter(-60, "dB")


def volume(signal: Signal, ping: Ping, rng: np.random.Generator, *, strength_db: float) -> Signal:
    """Haze added to the field, with the grain that the device gives to every echo."""
    sonar = ping.sonar
    across_rad = np.deg2rad(sonar.hfov_deg) / sonar.beams
    upright_rad = np.deg2rad(sonar.vfov_deg)
    range_m = np.maximum(ping.range_m, ping.bin_m)
    level = 10 ** (strength_db / 10) * across_rad * upright_rad * ping.bin_m / range_m**2
    amplitude = np.sqrt(level * ping.scatterers.loss).astype(np.float32)
    add_white_noise(signal.field, rng, amplitude)
    return signal


VOLUME = Effect(VolumeSettings, volume, "echo")
