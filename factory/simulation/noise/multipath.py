"""Echoes that a level plane mirrors: the sea surface or the bottom."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.distribution import Angle, Distribution, NonNegativeDecibels, as_written, within
from ...common.settings import STRICT
from ..imaging.effect import Effect, EffectSettings, Rng, parameter
from ..imaging.expected import Expected
from ..imaging.signal import Ping, Signal, is_audible
from ..sonar.surface import vertical_table


@dataclass(frozen=True, config=STRICT)
class SurfaceMultipathSettings(EffectSettings):
    """Keys of `noise.surface_multipath`; the plane is water.depth_m above the sonar.

    loss_db: lost at each reflection, dB; a calm surface 1, a rough one at high frequency 10.
    tilt_deg: how far the sonar looks down, so that the plane lies level.
    """

    loss_db: NonNegativeDecibels = parameter(6, "dB")
    tilt_deg: Angle = parameter(0, "deg")


@dataclass(frozen=True, config=STRICT)
class BottomMultipathSettings(EffectSettings):
    """Keys of `noise.bottom_multipath`.

    altitude_m: height of the sonar above a level bottom, metres.
    loss_db: lost at each reflection, dB; rock 3, sand 8, mud 15.
    tilt_deg: how far the sonar looks down.
    """

    altitude_m: Annotated[Distribution, within(0, 1000, "m"), as_written] = parameter(2, "m")
    loss_db: NonNegativeDecibels = parameter(12, "dB")
    tilt_deg: Angle = parameter(0, "deg")


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
