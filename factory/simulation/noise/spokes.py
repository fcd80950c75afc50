"""Spokes: noise of other sonars and propellers at single bearings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Count, Decibels, Distribution, as_written, within
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping

# A spoke is cut off this many standard deviations from its centre.
_SPOKE_REACH = 4


@dataclass(frozen=True, config=STRICT)
class SpokesSettings(EffectSettings):
    """Keys of `noise.spokes`.

    count: number of spokes (rounded).
    spacing: random bearings, or regular: equally many beams apart, from a random first one, as of
        a neighbour whose pings and the device's beams step together.
    level_db: of a spoke's noise against full scale, dB (negative).
    width_beams: its width, one standard deviation, beams.
    """

    count: Count = parameter(1, "1")
    level_db: Decibels = parameter(-25, "dB")
    width_beams: Annotated[Distribution, within(0, 8192), as_written] = parameter(0.7, "1")
    spacing: Literal["random", "regular"] = parameter("random")


class Spoke(NamedTuple):
    """One spoke: noise of n neighbouring beams at all ranges.

    beams: slice of the n beams.
    noise: (looks, 2, range_bins, n) float32 standard normal values, real and imaginary parts.
    amplitude: (n,) float32 factor on the noise.
    """

    beams: slice
    noise: Float32s
    amplitude: Float32s


def spokes(field: Float32s, ping: Ping, rng: Rng, **parameters: Any) -> Float32s:
    """Add noise at single bearings and all ranges, as from other sonars and propellers."""
    for spoke in _draw_spokes(ping, rng, field.shape[0], **parameters):
        field[..., spoke.beams] += spoke.noise * spoke.amplitude
    return field


def realise_spokes(state: Expected, ping: Ping, rng: Rng, **parameters: Any) -> None:
    """Add the mean noise intensity of this sample's spokes, in place."""
    for spoke in _draw_spokes(ping, rng, round(state.looks), **parameters):
        state.noise[:, spoke.beams] += 2 * spoke.amplitude**2


def _draw_spokes(
    ping: Ping,
    rng: Rng,
    looks: int,
    *,
    count: float,
    level_db: float,
    width_beams: float,
    spacing: str = "random",
) -> Iterator[Spoke]:
    """Draw the spokes of a sample one by one.  Parameters: see `SpokesSettings`."""
    rows, beams = ping.shape
    spoke_count = round(count)
    width = max(width_beams, 0.1)
    peak_amplitude = np.sqrt(ping.full_scale / 2) * 10 ** (level_db / 20)
    first_centre = 0.0
    for number in range(spoke_count):
        # Drawn for every spoke, although regular spokes use the first draw alone.
        centre = rng.random() * beams
        if spacing == "regular":
            if number == 0:
                first_centre = centre
            centre = (first_centre + number * beams / spoke_count) % beams

        first = max(int(centre - _SPOKE_REACH * width), 0)
        stop = min(int(centre + _SPOKE_REACH * width) + 1, beams)
        offset_in_widths = (np.arange(first, stop) + 0.5 - centre) / width
        amplitude = peak_amplitude * np.exp(-(offset_in_widths**2) / 4)
        noise = rng.standard_normal((looks, 2, rows, stop - first), dtype=np.float32)
        yield Spoke(slice(first, stop), noise, amplitude.astype(np.float32))


SPOKES = Effect(SpokesSettings, spokes, "image", "spokes", realised=realise_spokes)
