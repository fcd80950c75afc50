"""The device hears itself: ring-down of the transmitter, and lines of echoes in the housing."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Decibels, Distribution, NonNegativeDecibels, as_written, within
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping

# What is weaker against full scale is not computed, dB.
_FAINTEST_DB = -90

_Decay = Annotated[Distribution, within(1e-3, 1e5, "dB/m"), as_written]


@dataclass(frozen=True, config=STRICT)
class RingDownSettings(EffectSettings):
    """Keys of `noise.ring_down`: the transducer goes on swinging after the pulse.

    level_db: at range 0 against full scale, dB.
    decay_db_per_m: how fast it dies, dB per metre of range.
    """

    level_db: Decibels = parameter(0, "dB")
    decay_db_per_m: _Decay = parameter(40, "dB/m")


def ring_down(
    field: Float32s, ping: Ping, rng: Rng, *, level_db: float, decay_db_per_m: float
) -> Float32s:
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

    level_db: Decibels = parameter(-10, "dB")
    spacing_m: Annotated[Distribution, within(5e-3, 1000, "m"), as_written] = parameter(0.1, "m")
    decay_db: NonNegativeDecibels = parameter(3, "dB")
    uneven_db: Annotated[Distribution, within(0, 60, "dB"), as_written] = parameter(3, "dB")


def comb_lines(field: Float32s, ping: Ping, rng: Rng, **parameters: float) -> Float32s:
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
) -> Iterator[tuple[int, Float32s, float]]:
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
