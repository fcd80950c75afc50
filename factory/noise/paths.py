"""Echoes that come another way: mirrored by planes, through sidelobes and channels, from others."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Literal, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from ..distribution import AnyNumber, NonNegative, Positive
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.scatterers import vertical_table
from ..imaging.signal import Floats, Ping, Signal, mixing, sounds
from ..settings import STRICT

# Beyond so many widths a spoke is not there.
_REACH = 4


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
    """A level mirror.

    height_m: above the sonar, negative below.  loss_db: lost at each reflection.
    tilt_deg: how far the sonar looks down, so that the plane lies level.
    """

    height_m: float
    loss_db: float
    tilt_deg: float


def _add_mirrored_echoes(signal: Signal, ping: Ping, plane: Plane) -> Signal:
    """The signal with the echoes that come by way of a plane.

    With r the way to a point and r' that from the mirrored sonar, a path that touches the plane
    once comes in at range (r + r') / 2, twice in phase, one that touches it both ways at r' (Urick
    1983, ch. 5; Allen & Berkley, J. Acoust. Soc. Am. 65 (1979), 943, for the method).
    """
    from ..imaging import kernels  # loads numba

    has_power = sounds(signal.power)
    if not (has_power or signal.field.size):
        return signal

    field = signal.field.copy()
    # With speckle there is no power; what is there is the frame's, and no effect may change it.
    power = signal.power.copy() if has_power else np.empty(0, np.float32)
    planes = (2 * len(signal.field), signal.power.size)
    tilt_rad = np.deg2rad(plane.tilt_deg)
    kernels.mirror(
        *ping.scatterers.surface,
        ping.sonar.mount.axes(),
        (plane.height_m, float(np.cos(tilt_rad)), float(np.sin(tilt_rad))),
        vertical_table(ping.sonar),
        10 ** (-plane.loss_db / 10),
        np.log(10) / 10 * ping.absorption_db_per_m,
        1 / ping.bin_m,
        ping.sonar.beams,
        (
            (signal.power.reshape(-1), signal.field.reshape(planes)),
            (power.reshape(-1), field.reshape(planes)),
        ),
    )
    return Signal(power if has_power else signal.power, field)


def _expect_mirrored_echoes(state: Expected, ping: Ping, plane: Plane) -> None:
    """Each ghost is as wide as what it mirrors."""
    for intensity in (state.echo, state.steady):
        no_field = np.empty((0, 2, *intensity.shape), np.float32)
        mirrored = _add_mirrored_echoes(Signal(intensity, no_field), ping, plane)
        intensity[:] = mirrored.power


def surface_multipath(
    signal: Signal, ping: Ping, rng: Rng, *, loss_db: float, tilt_deg: float
) -> Signal:
    """Echoes by way of the sea surface, water.depth_m above the sonar."""
    return _add_mirrored_echoes(signal, ping, Plane(ping.water.depth_m, loss_db, tilt_deg))


def expect_surface_multipath(
    state: Expected, ping: Ping, rng: Rng, *, loss_db: float, tilt_deg: float
) -> None:
    """Their intensities."""
    _expect_mirrored_echoes(state, ping, Plane(ping.water.depth_m, loss_db, tilt_deg))


def bottom_multipath(
    signal: Signal, ping: Ping, rng: Rng, *, altitude_m: float, loss_db: float, tilt_deg: float
) -> Signal:
    """Echoes by way of a level bottom."""
    return _add_mirrored_echoes(signal, ping, Plane(-altitude_m, loss_db, tilt_deg))


def expect_bottom_multipath(
    state: Expected, ping: Ping, rng: Rng, *, altitude_m: float, loss_db: float, tilt_deg: float
) -> None:
    """Their intensities."""
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
    """A strong return leaks into every beam of its range row, with one random phase a row.

    Beam patterns of `sonar.array` have the sidelobes of a perfect array; those of a real one do not
    fall below -20 to -35 dB of the strongest return, whatever the bearing.
    """
    strongest = (field[:, 0] ** 2 + field[:, 1] ** 2).max(axis=-1)
    leak = np.sqrt(strongest) * np.float32(10 ** (level_db / 20))
    phase = 2 * np.pi * rng.random(leak.shape, dtype=np.float32)
    arcs = np.stack([leak * np.cos(phase), leak * np.sin(phase)], axis=1)
    field += arcs[..., None]
    return field


def expect_sidelobe_arcs(state: Expected, ping: Ping, rng: Rng, *, level_db: float) -> None:
    """The leak of each row, which has one phase in all beams.

    The strongest of n independent exponential values is 1 + 1/2 + ... + 1/n of their mean; a row
    has as many as its intensity is spread over, in steps of what the device resolves.
    """
    total = state.total()
    strongest = total.max(axis=1)
    beams_wide = max(float(1 / np.median(ping.beam_share)), 1)
    independent = total.sum(axis=1) / np.maximum(strongest, 1e-37) / beams_wide
    count = np.maximum(independent, 1)
    # Harmonic numbers less 1, within 0.1.
    more = np.log(count) - 0.423 * (1 - np.exp(1 - count))
    fluctuating = 1 - state.steady.max(axis=1) / np.maximum(strongest, 1e-37)
    leak = strongest * (1 + more * np.clip(fluctuating, 0, 1))
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
    """Channels that are read out side by side leak into each other, to the left and the right."""
    step, leaks = max(round(spacing_beams), 1), np.float32(10 ** (level_db / 20)) * field
    field[..., step:] += leaks[..., :-step]
    field[..., :-step] += leaks[..., step:]
    return field


def expect_crosstalk(
    state: Expected, ping: Ping, rng: Rng, *, level_db: float, spacing_beams: float
) -> None:
    """Intensities of the leaks, and what they add in phase: beams that overlap are alike."""
    leak, step = np.float32(10 ** (level_db / 20)), max(round(spacing_beams), 1)
    middle, alike = ping.sonar.beams // 2, 0.0
    if middle + step < ping.sonar.beams:
        one, other = (
            mixing(ping.sonar)[:, beam].astype(np.float64) for beam in (middle, middle + step)
        )
        alike = float(one @ other / np.sqrt((one @ one) * (other @ other)))
    for plane, correlation in (
        (state.echo, alike),
        (state.noise, 0.0),
        (state.steady, 1.0),
        (state.textured, alike),
    ):
        wide = np.pad(np.sqrt(plane), ((0, 0), (step, step)))
        left, here, right = wide[:, : -2 * step], wide[:, step:-step], wide[:, 2 * step :]
        leaked = plane + leak * leak * (left * left + right * right)
        together = np.float32(2 * float(leak) * float(np.float32(correlation)))
        in_phase = together * here * (left + right)
        np.maximum(leaked + in_phase, 0, out=plane)


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


def spokes(field: Floats, ping: Ping, rng: Rng, **parameters: Any) -> Floats:
    """Noise around single bearings at all ranges, from other sonars and propellers."""
    for across, noise, amplitude in _each(ping, rng, field.shape[0], **parameters):
        field[..., across] += noise * amplitude
    return field


def realise_spokes(state: Expected, ping: Ping, rng: Rng, **parameters: Any) -> None:
    """The spokes of this sample, with the mean intensity of their noise."""
    for across, _, amplitude in _each(ping, rng, round(state.looks), **parameters):
        state.noise[:, across] += 2 * amplitude**2


def _each(
    ping: Ping, rng: Rng, looks: int, *, count: float, level_db: float, width_beams: float,
    spacing: str = "random",
) -> Iterator[tuple[slice, Floats, Floats]]:  # fmt: skip
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


SPOKES = Effect(SpokesSettings, spokes, "picture", "spokes", realised=realise_spokes)
