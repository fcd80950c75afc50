"""Spokes: single bearings that are too loud at all ranges, from other sonars and propellers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber, NonNegative
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Floats, Ping
from ...imaging.effect import Effect, EffectSettings, option, parameter
from ...settings import STRICT

# Beyond so many widths a spoke is not there.
_REACH = 4


@dataclass(frozen=True, config=STRICT)
class SpokesSettings(EffectSettings):
    """Keys of `noise.spokes`.

    count: number of spokes (rounded).
    spacing: random bearings, or regular: equally many beams apart, from a random first one, as of
        a neighbour whose pings and the device's beams step together.
    level_db: of a spoke's noise against full scale, dB (negative).
    width_beams: its width, one standard deviation, beams.
    """

    count: NonNegative = parameter(1, "1")
    level_db: AnyNumber = parameter(-25, "dB")
    width_beams: NonNegative = parameter(0.7, "1")
    spacing: Literal["random", "regular"] = option("random")


def spokes(field: Floats, ping: Ping, rng: np.random.Generator, **parameters: Any) -> Floats:
    """The field with noise added around the bearings of the spokes; see `SpokesSettings`."""
    for across, noise, amplitude in _each(ping, rng, field.shape[0], **parameters):
        field[..., across] += noise * amplitude
    return field


def realise_spokes(
    expected: Expected, ping: Ping, rng: np.random.Generator, **parameters: Any
) -> None:
    """The spokes of this sample, with the mean intensity of their noise."""
    for across, _, amplitude in _each(ping, rng, round(expected.looks), **parameters):
        expected.noise[:, across] += 2 * amplitude**2


def _each(
    ping: Ping,
    rng: np.random.Generator,
    looks: int,
    *,
    count: float,
    level_db: float,
    width_beams: float,
    spacing: str = "random",
) -> Iterator[tuple[slice, Floats, Floats]]:
    """The beams of each spoke, its noise (looks, 2, range_bins, n) and amplitudes (n,)."""
    rows, beams = ping.shape
    width, first_at = max(width_beams, 0.1), 0.0
    for number in range(round(count)):
        centre = rng.random() * beams
        if spacing == "regular":
            first_at = centre if number == 0 else first_at
            centre = (first_at + number * beams / round(count)) % beams
        first = max(int(centre - _REACH * width), 0)
        last = min(int(centre + _REACH * width) + 1, beams)
        away = (np.arange(first, last) + 0.5 - centre) / width
        amplitude = np.sqrt(ping.full_scale / 2) * 10 ** (level_db / 20) * np.exp(-(away**2) / 4)
        noise = rng.standard_normal((looks, 2, rows, last - first), dtype=np.float32)
        yield slice(first, last), noise, amplitude.astype(np.float32)


SPOKES = Effect(SpokesSettings, spokes, "picture", artefact="spokes", realised=realise_spokes)
