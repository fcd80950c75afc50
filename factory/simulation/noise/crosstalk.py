"""Leaks between channels that are read out next to each other."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.distribution import Decibels, Distribution, as_written, within
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping, mixing


@dataclass(frozen=True, config=STRICT)
class CrosstalkSettings(EffectSettings):
    """Keys of `noise.crosstalk`.

    level_db: of the leak below the channel it comes from, dB (negative).
    spacing_beams: distance between channels that leak (rounded); devices that make their beams in
        several pings leak among those of one ping.
    """

    level_db: Decibels = parameter(-35, "dB")
    spacing_beams: Annotated[Distribution, within(1e-6, 8192), as_written] = parameter(1, "1")


def crosstalk(
    field: Float32s, ping: Ping, rng: Rng, *, level_db: float, spacing_beams: float
) -> Float32s:
    """Leak each channel into the channels read out next to it, left and right."""
    step = max(round(spacing_beams), 1)
    if step >= field.shape[-1]:
        return field  # there are no channels so far apart
    leaks = np.float32(10 ** (level_db / 20)) * field
    field[..., step:] += leaks[..., :-step]
    field[..., :-step] += leaks[..., step:]
    return field


def expect_crosstalk(
    state: Expected, ping: Ping, rng: Rng, *, level_db: float, spacing_beams: float
) -> None:
    """Add the expected leaks to all intensities, in place.

    Echoes in overlapping beams are correlated, so their leaks add partly in phase.  Receiver noise
    is independent from beam to beam; the steady intensity adds fully in phase.
    """
    leak = np.float32(10 ** (level_db / 20))
    step = max(round(spacing_beams), 1)
    if step >= ping.sonar.beams:
        return
    beam_correlation = _correlate_beams(ping, step)
    _add_leaks(state.echo, leak, step, beam_correlation)
    _add_leaks(state.noise, leak, step, 0.0)
    _add_leaks(state.steady, leak, step, 1.0)
    _add_leaks(state.textured, leak, step, beam_correlation)


def _correlate_beams(ping: Ping, step: int) -> float:
    """Return the correlation of speckle in the middle beam and in the beam `step` to its right.

    0 where the fan has no such beam.
    """
    middle = ping.sonar.beams // 2
    if middle + step >= ping.sonar.beams:
        return 0.0

    beam_mixing = mixing(ping.sonar)
    weights = beam_mixing[:, middle].astype(np.float64)
    neighbour_weights = beam_mixing[:, middle + step].astype(np.float64)
    norm = np.sqrt((weights @ weights) * (neighbour_weights @ neighbour_weights))
    return float(weights @ neighbour_weights / norm)


def _add_leaks(intensity: Float32s, leak: np.float32, step: int, correlation: float) -> None:
    """Add what the beams `step` to the left and right leak into each beam, in place.

    intensity: (range_bins, beams) float32.  leak: factor on amplitudes.
    correlation: of the complex fields of a beam and of the beam that leaks into it, 0 to 1.
    """
    padded_amplitude = np.pad(np.sqrt(intensity), ((0, 0), (step, step)))
    left = padded_amplitude[:, : -2 * step]
    middle = padded_amplitude[:, step:-step]
    right = padded_amplitude[:, 2 * step :]

    with_leaks = intensity + leak * leak * (left * left + right * right)
    in_phase_factor = np.float32(2 * float(leak) * float(np.float32(correlation)))
    in_phase = in_phase_factor * middle * (left + right)
    np.maximum(with_leaks + in_phase, 0, out=intensity)


CROSSTALK = Effect(CrosstalkSettings, crosstalk, "beam", "haze", systematic=expect_crosstalk)
