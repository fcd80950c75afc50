"""Gains that a device gets wrong: of beams, of the edges of its sector, over range."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s, Float64s
from ...common.distribution import Count, Decibels, DecibelsPerMetre, NonNegativeDecibels
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, Scope, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping

GainsDb = Float64s


@dataclass(frozen=True, config=STRICT)
class BeamGainSettings(EffectSettings):
    """Keys of `noise.beam_gain`: channels that are not alike, and some that are dead.

    They are the device's, so all frames of a recording have the same ones.
    sigma_db: standard deviation of the gains, dB.
    dead: number of dead beams (rounded).  dead_db: their gain, dB.
    """

    sigma_db: NonNegativeDecibels = parameter(0.5, "dB")
    dead: Count = parameter(0, "1")
    dead_db: Decibels = parameter(-40, "dB")


@dataclass(frozen=True, config=STRICT)
class SectorEdgesSettings(EffectSettings):
    """Keys of `noise.sector_edges`: transmitter and receivers look ahead, and less to the sides.

    Images of the Marine Debris Dataset are a third darker at the sides of the sector than in its
    middle (docs/realism.md); makers give a sector as the width at which that is 3 dB.
    level_db: how far the outermost bearings of the sector lie below straight ahead, dB; in between
        it grows with the square of the bearing, as the main lobe of a beam pattern does.
    """

    level_db: NonNegativeDecibels = parameter(3, "dB")


@dataclass(frozen=True, config=STRICT)
class TvgErrorSettings(EffectSettings):
    """Keys of `noise.tvg_error`: a time-varying gain that does not fit the water.

    It is right in the middle of the range window.
    db_per_decade: too much (or, negative, too little) gain for each tenfold range, dB.
    db_per_m: the same for each metre, dB/m.
    """

    db_per_decade: Decibels = parameter(0, "dB")
    db_per_m: DecibelsPerMetre = parameter(0, "dB/m")


def beam_gain_db(ping: Ping, rng: Rng, *, sigma_db: float, dead: float, dead_db: float) -> GainsDb:
    """Draw the gain of each beam, (beams,) dB."""
    gain_db = sigma_db * rng.standard_normal(ping.sonar.beams)
    gain_db[rng.permutation(ping.sonar.beams)[: round(dead)]] = dead_db
    return gain_db


def sector_edges_db(ping: Ping, rng: Rng, *, level_db: float) -> GainsDb:
    """Gain at the bearing of each beam, (beams,) dB; 0 straight ahead."""
    side = ping.sonar.beam_centres_rad() / (np.deg2rad(ping.sonar.hfov_deg) / 2)
    return np.asarray(-level_db * side**2)


def tvg_error_db(ping: Ping, rng: Rng, *, db_per_decade: float, db_per_m: float) -> GainsDb:
    """Gain at each range, (range_bins, 1) dB; 0 in the middle of the window."""
    range_m = np.maximum(ping.range_m.astype(np.float64), ping.bin_m)[:, None]
    middle_m = (ping.window.range_min_m + ping.window.range_max_m) / 2
    return np.asarray(
        db_per_decade * np.log10(range_m / middle_m) + db_per_m * (range_m - middle_m)
    )


def _gain_effect(
    settings: type[EffectSettings], gain_db: Callable[..., GainsDb], scope: Scope = "sample"
) -> Effect:
    """The effect of a gain in dB, `(ping, rng, **parameters)`, on fields and on expectations."""

    def apply(field: Float32s, ping: Ping, rng: Rng, **parameters: float) -> Float32s:
        field *= (10 ** (gain_db(ping, rng, **parameters) / 20)).astype(np.float32)
        return field

    def expect(state: Expected, ping: Ping, rng: Rng, **parameters: float) -> None:
        state.scale(10 ** (gain_db(ping, rng, **parameters) / 10))

    return Effect(settings, apply, "image", "gains", scope, systematic=expect)


BEAM_GAIN = _gain_effect(BeamGainSettings, beam_gain_db, "recording")
SECTOR_EDGES = _gain_effect(SectorEdgesSettings, sector_edges_db)
TVG_ERROR = _gain_effect(TvgErrorSettings, tvg_error_db)
