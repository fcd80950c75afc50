"""Volume reverberation: the water's own scatterers, a haze behind and before everything.

A bin at range r has the volume r^2 theta phi dr; its echo is s_v V / r^4 without absorption, with
theta the bin's bearings and phi the integral of the two-way vertical pattern (Urick 1983, ch. 8).
The scatterers drift, so every frame has a haze of its own.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Ping, Signal, add_white_noise
from ...imaging.contract import Floats
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT
from ...sonar import array


@dataclass(frozen=True, config=STRICT)
class VolumeSettings(EffectSettings):
    """Keys of `noise.volume`.

    strength_db: volume scattering strength, dB re 1/m; clear water -70, a harbour -45.
    """

    strength_db: AnyNumber = parameter(-60, "dB")


def volume(signal: Signal, ping: Ping, rng: np.random.Generator, *, strength_db: float) -> Signal:
    """Haze added to the field, with the grain that the device gives to every echo."""
    along, across = haze(ping, strength_db)
    add_white_noise(signal.field, rng, np.sqrt(along), np.sqrt(across))
    return signal


def haze(ping: Ping, strength_db: float) -> tuple[Floats, Floats]:
    """Expected intensity of the haze in each bin: (range_bins,) times (beams,) float32."""
    sonar = ping.sonar
    upright_rad = array.vertical_width_rad(sonar.vfov_deg, sonar.array)
    range_m = np.maximum(ping.range_m, ping.bin_m)
    along = 10 ** (strength_db / 10) * upright_rad * ping.bin_m / range_m**2 * ping.scatterers.loss
    across_rad = np.gradient(sonar.beam_centres_rad())
    return along.astype(np.float32), across_rad.astype(np.float32)


def expect_volume(
    expected: Expected, ping: Ping, rng: np.random.Generator, *, strength_db: float
) -> None:
    """The haze's intensity, which the point-spread leaves as it is."""
    along, across = haze(ping, strength_db)
    expected.echo += along[:, None] * across


VOLUME = Effect(
    VolumeSettings, volume, "echo", systematic=True, expected=expect_volume, artefact="haze"
)
