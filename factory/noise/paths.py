"""Echoes on indirect paths: multipath, sidelobes, crosstalk between channels, other sonars."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from ..distribution import AnyNumber, NonNegative, Positive
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.scatterers import vertical_table
from ..imaging.signal import Floats, Ping, Signal, is_audible, mixing
from ..settings import STRICT

# A spoke is cut off this many standard deviations from its centre.
_SPOKE_REACH = 4


@dataclass(frozen=True, config=STRICT)
class SurfaceMultipathSettings(EffectSettings):
    """Keys of `noise.surface_multipath`; the plane is water.depth_m above the sonar.

    loss_db: lost at each reflection, dB; a calm surface 1, a rough one at high frequency 10.
    tilt_deg: how far the sonar looks down, so that the plane lies level.
    """

    loss_db: NonNegative = parameter(6, "dB")
    tilt_deg: AnyNumber = parameter(0, "deg")


@dataclass(frozen=True, config=STRICT)
class BottomMultipathSettings(EffectSettings):
    """Keys of `noise.bottom_multipath`.

    altitude_m: height of the sonar above a level bottom, metres.
    loss_db: lost at each reflection, dB; rock 3, sand 8, mud 15.
    tilt_deg: how far the sonar looks down.
    """

    altitude_m: NonNegative = parameter(2, "m")
    loss_db: NonNegative = parameter(12, "dB")
    tilt_deg: AnyNumber = parameter(0, "deg")


class Plane(NamedTuple):
    """A level plane that mirrors sound: the sea surface or a flat bottom.

    height_m: above the sonar, negative below.
    loss_db: intensity lost at each reflection, dB.
    tilt_deg: how far the sonar looks down; the plane stays level.
    """

    height_m: float
    loss_db: float
    tilt_deg: float


def _add_mirrored_echoes(signal: Signal, ping: Ping, plane: Plane) -> Signal:
    """Return a copy of the signal with the echoes that a plane reflects added.

    Let r be the range of a point from the sonar and r' its range from the sonar's mirror image.
    Paths that touch the plane once, on the way out or on the way back, arrive in phase at range
    (r + r') / 2; the path that touches it on both ways arrives at r' (Urick 1983, ch. 5; image
    method: Allen & Berkley, J. Acoust. Soc. Am. 65 (1979), 943).
    """
    from ..imaging import kernels  # loads numba

    has_power = is_audible(signal.power)
    if not (has_power or signal.field.size):
        return signal

    mirrored_field = signal.field.copy()
    # Speckle leaves no mean power.  The loop skips an empty array, and the signal keeps its zeros.
    mirrored_power = signal.power.copy() if has_power else np.empty(0, np.float32)
    planes_by_bins = (2 * len(signal.field), signal.power.size)
    direct_echoes = (signal.power.reshape(-1), signal.field.reshape(planes_by_bins))
    mirrored_echoes = (mirrored_power.reshape(-1), mirrored_field.reshape(planes_by_bins))

    surface_bins, surface_points_m = ping.scatterers.surface
    tilt_rad = np.deg2rad(plane.tilt_deg)
    height_and_tilt = (plane.height_m, float(np.cos(tilt_rad)), float(np.sin(tilt_rad)))
    reflected_intensity = 10 ** (-plane.loss_db / 10)
    nepers_per_m = np.log(10) / 10 * ping.absorption_db_per_m
    bins_per_m = 1 / ping.bin_m
    kernels.mirror(
        surface_bins,
        surface_points_m,
        ping.sonar.mount.axes(),
        height_and_tilt,
        vertical_table(ping.sonar),
        reflected_intensity,
        nepers_per_m,
        bins_per_m,
        ping.sonar.beams,
        (direct_echoes, mirrored_echoes),
    )
    return Signal(mirrored_power if has_power else signal.power, mirrored_field)


def _expect_mirrored_echoes(state: Expected, ping: Ping, plane: Plane) -> None:
    """Add the mirrored intensities to the expected echoes, fluctuating and steady, in place."""
    for intensity in (state.echo, state.steady):
        no_field = np.empty((0, 2, *intensity.shape), np.float32)
        mirrored = _add_mirrored_echoes(Signal(intensity, no_field), ping, plane)
        intensity[:] = mirrored.power


def surface_multipath(
    signal: Signal, ping: Ping, rng: Rng, *, loss_db: float, tilt_deg: float
) -> Signal:
    """Add the echoes that the sea surface reflects, water.depth_m above the sonar."""
    return _add_mirrored_echoes(signal, ping, Plane(ping.water.depth_m, loss_db, tilt_deg))


def expect_surface_multipath(
    state: Expected, ping: Ping, rng: Rng, *, loss_db: float, tilt_deg: float
) -> None:
    """Add the intensities of the echoes that the sea surface reflects."""
    _expect_mirrored_echoes(state, ping, Plane(ping.water.depth_m, loss_db, tilt_deg))


def bottom_multipath(
    signal: Signal, ping: Ping, rng: Rng, *, altitude_m: float, loss_db: float, tilt_deg: float
) -> Signal:
    """Add the echoes that a level bottom reflects."""
    return _add_mirrored_echoes(signal, ping, Plane(-altitude_m, loss_db, tilt_deg))


def expect_bottom_multipath(
    state: Expected, ping: Ping, rng: Rng, *, altitude_m: float, loss_db: float, tilt_deg: float
) -> None:
    """Add the intensities of the echoes that the bottom reflects."""
    _expect_mirrored_echoes(state, ping, Plane(-altitude_m, loss_db, tilt_deg))


SURFACE_MULTIPATH = Effect(
    SurfaceMultipathSettings,
    surface_multipath,
    "echo",
    "ghosts",
    systematic=expect_surface_multipath,
)
BOTTOM_MULTIPATH = Effect(
    BottomMultipathSettings,
    bottom_multipath,
    "echo",
    "ghosts",
    systematic=expect_bottom_multipath,
)


@dataclass(frozen=True, config=STRICT)
class SidelobeArcsSettings(EffectSettings):
    """Keys of `noise.sidelobe_arcs`.

    level_db: of the leak below the strongest return of the row, dB (negative).
    """

    level_db: AnyNumber = parameter(-30, "dB")


def sidelobe_arcs(field: Floats, ping: Ping, rng: Rng, *, level_db: float) -> Floats:
    """Leak the strongest return of each range row into all its beams, with one random phase a row.

    Beam patterns of `sonar.array` have the sidelobes of a perfect array.  Those of a real array do
    not fall below -20 to -35 dB of the strongest return at any bearing.
    """
    strongest_intensity = (field[:, 0] ** 2 + field[:, 1] ** 2).max(axis=-1)
    leak = np.sqrt(strongest_intensity) * np.float32(10 ** (level_db / 20))
    phase_rad = 2 * np.pi * rng.random(leak.shape, dtype=np.float32)
    arcs = np.stack([leak * np.cos(phase_rad), leak * np.sin(phase_rad)], axis=1)
    field += arcs[..., None]
    return field


def expect_sidelobe_arcs(state: Expected, ping: Ping, rng: Rng, *, level_db: float) -> None:
    """Add the expected leak of each row to the steady intensity, in place.

    The strongest of n independent exponential values is on average 1 + 1/2 + ... + 1/n times their
    mean.  n is the number of resolution cells over which the intensity of a row is spread.
    """
    total = state.total()
    strongest = total.max(axis=1)
    nonzero_strongest = np.maximum(strongest, 1e-37)
    beams_per_cell = max(float(1 / np.median(ping.beam_share)), 1)
    cell_count = np.maximum(total.sum(axis=1) / nonzero_strongest / beams_per_cell, 1)

    # The harmonic number of the cell count less 1, within 0.1.
    excess_of_maximum = np.log(cell_count) - 0.423 * (1 - np.exp(1 - cell_count))
    fluctuating_part = 1 - state.steady.max(axis=1) / nonzero_strongest
    leak = strongest * (1 + excess_of_maximum * np.clip(fluctuating_part, 0, 1))
    state.steady += (leak * 10 ** (level_db / 10)).astype(np.float32)[:, None]


SIDELOBE_ARCS = Effect(
    SidelobeArcsSettings, sidelobe_arcs, "beam", "ghosts", systematic=expect_sidelobe_arcs
)


@dataclass(frozen=True, config=STRICT)
class CrosstalkSettings(EffectSettings):
    """Keys of `noise.crosstalk`.

    level_db: of the leak below the channel it comes from, dB (negative).
    spacing_beams: distance between channels that leak (rounded); devices that make their beams in
        several pings leak among those of one ping.
    """

    level_db: AnyNumber = parameter(-35, "dB")
    spacing_beams: Positive = parameter(1, "1")


def crosstalk(
    field: Floats, ping: Ping, rng: Rng, *, level_db: float, spacing_beams: float
) -> Floats:
    """Leak each channel into the channels read out next to it, left and right."""
    step = max(round(spacing_beams), 1)
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


def _add_leaks(intensity: Floats, leak: np.float32, step: int, correlation: float) -> None:
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
    spacing: Literal["random", "regular"] = parameter("random")


class Spoke(NamedTuple):
    """One spoke: noise of n neighbouring beams at all ranges.

    beams: slice of the n beams.
    noise: (looks, 2, range_bins, n) float32 standard normal values, real and imaginary parts.
    amplitude: (n,) float32 factor on the noise.
    """

    beams: slice
    noise: Floats
    amplitude: Floats


def spokes(field: Floats, ping: Ping, rng: Rng, **parameters: Any) -> Floats:
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
