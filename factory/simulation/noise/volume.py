"""Haze: the echoes of the water itself."""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Decibels
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping, Signal, add_white_noise
from ..sonar import array


@dataclass(frozen=True, config=STRICT)
class VolumeSettings(EffectSettings):
    """Keys of `noise.volume`.

    strength_db: volume scattering strength, dB re 1/m; clear water -70, a harbour -45.
    """

    strength_db: Decibels = parameter(-60, "dB")


def volume(signal: Signal, ping: Ping, rng: Rng, *, strength_db: float) -> Signal:
    """Volume reverberation: the water's own scatterers, with the grain that every echo has.

    They drift, so every frame has a haze of its own.
    """
    along, across = haze_intensity(ping, strength_db)
    add_white_noise(signal.field, rng, np.sqrt(along), np.sqrt(across))
    return signal


def haze_intensity(ping: Ping, strength_db: float) -> tuple[Float32s, Float32s]:
    """Expected intensity of the haze in each bin: (range_bins,) times (beams,) float32.

    s_v V / r^4 of the volume V = r^2 theta phi dr: theta the bin's bearings, phi the integral of
    the two-way vertical pattern (Urick 1983, ch. 8).
    """
    sonar = ping.sonar
    upright_rad = array.vertical_width_rad(sonar.vfov_deg, sonar.array)
    range_m = np.maximum(ping.range_m, ping.bin_m)
    along = 10 ** (strength_db / 10) * upright_rad * ping.bin_m / range_m**2 * ping.scatterers.loss
    across_rad = np.gradient(sonar.beam_centres_rad())
    return along.astype(np.float32), across_rad.astype(np.float32)


def expect_volume(state: Expected, ping: Ping, rng: Rng, *, strength_db: float) -> None:
    """The haze's intensity, which the point-spread leaves as it is."""
    along, across = haze_intensity(ping, strength_db)
    state.echo += along[:, None] * across


VOLUME = Effect(VolumeSettings, volume, stage="echo", artefact="haze", systematic=expect_volume)
