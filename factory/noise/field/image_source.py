"""Multipath by image sources: echoes that come by way of the sea surface or the bottom.

The surface mirrors the sonar.  With r the way to a point and r' the way from the mirrored sonar,
a path that touches the plane once comes in at range (r + r') / 2, one that touches it both ways at
r' (Urick 1983, ch. 5; Allen & Berkley, J. Acoust. Soc. Am. 65 (1979), 943, for the method).  The
two once-touching paths, there and back, are equally long and add up in phase: four times the
intensity of one.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import AnyNumber, NonNegative
from ...imaging.coherent.beams import vertical_table
from ...imaging.coherent.expected import Expected
from ...imaging.coherent.signal import Ping, Signal, sounds
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT


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


def _with_images(
    signal: Signal, ping: Ping, height_m: float, loss_db: float, tilt_deg: float
) -> Signal:
    """Echoes by way of a level plane `height_m` above the sonar (negative: below)."""
    from ...imaging.coherent import kernels  # loads numba

    scene, tilt_rad = ping.scatterers, np.deg2rad(tilt_deg)
    powered = sounds(signal.power)
    if not (powered or signal.field.size):
        return signal
    field, planes = signal.field.copy(), (2 * signal.looks, signal.power.size)
    # With speckle there is none; what is there is the frame's, and no effect may change it.
    power = signal.power.copy() if powered else np.empty(0, np.float32)
    level = height_m, float(np.cos(tilt_rad)), float(np.sin(tilt_rad))
    kernels.mirror(
        *scene.surface, ping.sonar.mount.axes(), level,
        vertical_table(ping.sonar), 10 ** (-loss_db / 10),
        np.log(10) / 10 * ping.absorption_db_per_m, 1 / ping.bin_m, ping.sonar.beams,
        ((signal.power.reshape(-1), signal.field.reshape(planes)),
         (power.reshape(-1), field.reshape(planes))),
    )  # fmt: skip
    return Signal(power if power.size else signal.power, field)


def _effect(settings: type[EffectSettings], height_m: Callable[..., float]) -> Effect:
    """The effect of the plane at this height; it gets the ping and the parameters of its own."""

    def apply(
        signal: Signal, ping: Ping, rng: np.random.Generator, *, loss_db: float, tilt_deg: float,
        **own: float,
    ) -> Signal:  # fmt: skip
        return _with_images(signal, ping, height_m(ping, **own), loss_db, tilt_deg)

    def expect(
        expected: Expected, ping: Ping, rng: np.random.Generator, **parameters: float
    ) -> None:
        # Each ghost is as wide as what it mirrors.
        for plane in (expected.echo, expected.steady):
            unspeckled = Signal(plane, np.empty((0, 2, *plane.shape), np.float32))
            plane[:] = apply(unspeckled, ping, rng, **parameters).power

    return Effect(settings, apply, "echo", systematic=True, expected=expect, artefact="ghosts")


SURFACE_MULTIPATH = _effect(SurfaceMultipathSettings, lambda ping: ping.water.depth_m)
BOTTOM_MULTIPATH = _effect(BottomMultipathSettings, lambda ping, altitude_m: -altitude_m)
