"""What the device itself adds and gets wrong: noise, ring-down, lines, gains, saturation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ..distribution import AnyNumber, NonNegative, Positive
from ..imaging.effect import Effect, EffectSettings, Rng, Scope, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Floats, Ping, add_white_noise, beamform, white_noise
from ..settings import STRICT

Decibels = npt.NDArray[np.float64]

# Weaker than this against full scale it is not computed, dB.
_FAINTEST_DB = -90


@dataclass(frozen=True, config=STRICT)
class ReceiverSettings(EffectSettings):
    """Keys of `noise.receiver`.

    level_db: above the thermal noise of the sea in the device's band and beam, dB.
    grain: sample (each bin and beam for itself: a lens, an element a beam) or beam (through the
        beamformer and the pulse compression, with the grain of speckle).
    """

    level_db: AnyNumber = parameter(10, "dB")
    grain: Literal["sample", "beam"] = parameter("sample")


def receiver(field: Floats, ping: Ping, rng: Rng, *, level_db: float, grain: str) -> Floats:
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


@dataclass(frozen=True, config=STRICT)
class BeamGainSettings(EffectSettings):
    """Keys of `noise.beam_gain`: channels that are not alike, and some that are dead.

    They are the device's, so all frames of a recording have the same ones.
    sigma_db: standard deviation of the gains, dB.
    dead: number of dead beams (rounded).  dead_db: their gain, dB.
    """

    sigma_db: NonNegative = parameter(0.5, "dB")
    dead: NonNegative = parameter(0, "1")
    dead_db: AnyNumber = parameter(-40, "dB")


@dataclass(frozen=True, config=STRICT)
class SectorEdgesSettings(EffectSettings):
    """Keys of `noise.sector_edges`: transmitter and receivers look ahead, and less to the sides.

    Images of the Marine Debris Dataset are a third darker at the sides of the sector than in its
    middle (docs/realism.md); makers give a sector as the width at which that is 3 dB.
    level_db: how far the outermost bearings of the sector lie below straight ahead, dB; in between
        it grows with the square of the bearing, as the main lobe of a beam pattern does.
    """

    level_db: NonNegative = parameter(3, "dB")


@dataclass(frozen=True, config=STRICT)
class TvgErrorSettings(EffectSettings):
    """Keys of `noise.tvg_error`: a time-varying gain that does not fit the water.

    It is right in the middle of the range window.
    db_per_decade: too much (or, negative, too little) gain for each tenfold range, dB.
    db_per_m: the same for each metre, dB/m.
    """

    db_per_decade: AnyNumber = parameter(0, "dB")
    db_per_m: AnyNumber = parameter(0, "dB/m")


def beam_gain_db(ping: Ping, rng: Rng, *, sigma_db: float, dead: float, dead_db: float) -> Decibels:
    """(beams,) dB."""
    gain_db = sigma_db * rng.standard_normal(ping.sonar.beams)
    gain_db[rng.permutation(ping.sonar.beams)[: round(dead)]] = dead_db
    return gain_db


def sector_edges_db(ping: Ping, rng: Rng, *, level_db: float) -> Decibels:
    """(beams,) dB, none straight ahead."""
    side = ping.sonar.beam_centres_rad() / (np.deg2rad(ping.sonar.hfov_deg) / 2)
    return np.asarray(-level_db * side**2)


def tvg_error_db(ping: Ping, rng: Rng, *, db_per_decade: float, db_per_m: float) -> Decibels:
    """(range_bins, 1) dB."""
    range_m = np.maximum(ping.range_m.astype(np.float64), ping.bin_m)[:, None]
    middle_m = (ping.window.range_min_m + ping.window.range_max_m) / 2
    return np.asarray(
        db_per_decade * np.log10(range_m / middle_m) + db_per_m * (range_m - middle_m)
    )


def _of_gain(
    settings: type[EffectSettings], gain_db: Callable[..., Decibels], scope: Scope = "sample"
) -> Effect:
    """The effect of a gain in dB, `(ping, rng, **parameters)`, on fields and on expectations."""

    def apply(field: Floats, ping: Ping, rng: Rng, **parameters: float) -> Floats:
        field *= (10 ** (gain_db(ping, rng, **parameters) / 20)).astype(np.float32)
        return field

    def expect(state: Expected, ping: Ping, rng: Rng, **parameters: float) -> None:
        state.scale(10 ** (gain_db(ping, rng, **parameters) / 10))

    return Effect(settings, apply, "image", "gains", scope, systematic=expect)


BEAM_GAIN = _of_gain(BeamGainSettings, beam_gain_db, "recording")
SECTOR_EDGES = _of_gain(SectorEdgesSettings, sector_edges_db)
TVG_ERROR = _of_gain(TvgErrorSettings, tvg_error_db)


@dataclass(frozen=True, config=STRICT)
class RingDownSettings(EffectSettings):
    """Keys of `noise.ring_down`: the transducer goes on swinging after the pulse.

    level_db: at range 0 against full scale, dB.
    decay_db_per_m: how fast it dies, dB per metre of range.
    """

    level_db: AnyNumber = parameter(0, "dB")
    decay_db_per_m: Positive = parameter(40, "dB/m")


def ring_down(
    field: Floats, ping: Ping, rng: Rng, *, level_db: float, decay_db_per_m: float
) -> Floats:
    """Noise that is alike in all beams but for its phase; none in a window that begins beyond."""
    relative_db = level_db - decay_db_per_m * ping.range_m
    rows = int(np.count_nonzero(relative_db > _FAINTEST_DB))
    if not rows:
        return field
    amplitude = np.sqrt(ping.full_scale / 2) * 10 ** (relative_db[:rows] / 20)
    noise = rng.standard_normal((*field.shape[:2], rows, ping.sonar.beams), dtype=np.float32)
    field[:, :, :rows] += noise * amplitude.astype(np.float32)[:, None]
    return field


def expect_ring_down(
    state: Expected, ping: Ping, rng: Rng, *, level_db: float, decay_db_per_m: float
) -> None:
    """The intensity of the ring-down."""
    relative_db = level_db - decay_db_per_m * ping.range_m
    loud = np.where(relative_db > _FAINTEST_DB, ping.full_scale * 10 ** (relative_db / 10), 0)
    state.noise += loud.astype(np.float32)[:, None]


RING_DOWN = Effect(RingDownSettings, ring_down, "image", "spokes", systematic=expect_ring_down)


@dataclass(frozen=True, config=STRICT)
class CombLinesSettings(EffectSettings):
    """Keys of `noise.comb_lines`: echoes within the housing, lines at equal distances.

    level_db: of the first line against full scale, dB.
    spacing_m: from line to line, metres.  decay_db: from line to line, dB.
    uneven_db: standard deviation of a line's level from beam to beam, dB.
    """

    level_db: AnyNumber = parameter(-10, "dB")
    spacing_m: Positive = parameter(0.1, "m")
    decay_db: NonNegative = parameter(3, "dB")
    uneven_db: NonNegative = parameter(3, "dB")


def comb_lines(field: Floats, ping: Ping, rng: Rng, **parameters: float) -> Floats:
    """Lines, each one range bin thick, at distances that count from the sonar."""
    for row, line, phase in _lines(ping, rng, **parameters):
        field[:, 0, row] += line * np.float32(np.cos(phase))
        field[:, 1, row] += line * np.float32(np.sin(phase))
    return field


def expect_comb_lines(state: Expected, ping: Ping, rng: Rng, **parameters: float) -> None:
    """The intensity of the same lines."""
    for row, line, _ in _lines(ping, rng, **parameters):
        state.steady[row] += line * line


def _lines(
    ping: Ping, rng: Rng, *, level_db: float, spacing_m: float, decay_db: float, uneven_db: float
) -> Iterator[tuple[int, Floats, float]]:
    """The row, the (beams,) amplitudes and the phase of each line in the window."""
    lines = min(int((level_db - _FAINTEST_DB) / max(decay_db, 0.1)) + 1, 200)
    numbers = np.arange(1, max(lines, 0) + 1)
    rows = np.floor((numbers * spacing_m - ping.window.range_min_m) / ping.bin_m).astype(int)
    uneven = rng.standard_normal((len(numbers), ping.sonar.beams))
    phase = 2 * np.pi * rng.random(len(numbers))
    for index, row in enumerate(rows):
        if 0 <= row < ping.shape[0]:
            line_db = level_db - decay_db * index + uneven_db * uneven[index]
            line = (np.sqrt(ping.full_scale) * 10 ** (line_db / 20)).astype(np.float32)
            yield int(row), line, phase[index]


COMB_LINES = Effect(CombLinesSettings, comb_lines, "image", "spokes", systematic=expect_comb_lines)


@dataclass(frozen=True, config=STRICT)
class SaturationSettings(EffectSettings):
    """Keys of `noise.saturation`.

    level_db: largest amplitude against the strongest expected echo of the frame, before
        time-varying gain, dB.
    """

    level_db: AnyNumber = parameter(3, "dB")


def saturation(field: Floats, ping: Ping, rng: Rng, *, level_db: float) -> Floats:
    """No amplitude above the receiver's largest number, which it has before any gain."""
    limit = _limit(ping, level_db)
    intensity = (field**2).sum(axis=1)
    factor = np.ones_like(intensity)
    np.divide(limit, intensity, out=factor, where=intensity > limit)
    field *= np.sqrt(factor)[:, None]
    return field


def expect_saturation(state: Expected, ping: Ping, rng: Rng, *, level_db: float) -> None:
    """No expected intensity above the limit; single values above it are not taken from the mean."""
    limit = _limit(ping, level_db)
    total = state.total()
    if (total > limit).any():
        state.scale(np.minimum(limit / np.maximum(total, 1e-37), 1))


def _limit(ping: Ping, level_db: float) -> Floats:
    """(range_bins, 1) largest intensity after time-varying gain."""
    limit = np.asarray(ping.strongest * 10 ** (level_db / 10) * ping.gain, np.float32)
    return limit[:, None]


SATURATION = Effect(SaturationSettings, saturation, "image", "gains", systematic=expect_saturation)
