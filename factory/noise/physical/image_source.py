"""Multipath by image sources: echoes that come by way of the sea surface or the bottom.

The surface mirrors the sonar.  With r the way to a point and r' the way from the mirrored sonar,
a path that touches the plane once comes in at range (r + r') / 2, one that touches it both ways at
r' (Urick 1983, ch. 5; Allen & Berkley, J. Acoust. Soc. Am. 65 (1979), 943, for the method).  The
two once-touching paths, there and back, are equally long and add up in phase: four times the
intensity of one.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from factory.distribution import AnyNumber, NonNegative, number
from factory.field.signal import Floats, Ping, Signal
from factory.settings import STRICT

_FAINTEST = 1e-4


@dataclass(frozen=True, config=STRICT)
class SurfaceMultipathSettings:
    """Keys of `noise.surface_multipath`; the plane is water.depth_m above the sonar.

    loss_db: lost at each reflection, dB; a calm surface 1, a rough one at high frequency 10.
    tilt_deg: how far the sonar looks down, so that the plane lies level.
    """

    enabled: bool = True
    loss_db: NonNegative = number(6)
    tilt_deg: AnyNumber = number(0)


@dataclass(frozen=True, config=STRICT)
class BottomMultipathSettings:
    """Keys of `noise.bottom_multipath`.

    altitude_m: height of the sonar above a level bottom, metres.
    loss_db: lost at each reflection, dB; rock 3, sand 8, mud 15.
    tilt_deg: how far the sonar looks down.
    """

    enabled: bool = True
    altitude_m: NonNegative = number(2)
    loss_db: NonNegative = number(12)
    tilt_deg: AnyNumber = number(0)


def surface_multipath(
    signal: Signal, ping: Ping, rng: np.random.Generator, *, loss_db: float, tilt_deg: float
) -> Signal:
    """The signal and its echoes by way of the sea surface."""
    return _with_images(signal, ping, ping.water.depth_m, loss_db, tilt_deg)


def bottom_multipath(
    signal: Signal,
    ping: Ping,
    rng: np.random.Generator,
    *,
    altitude_m: float,
    loss_db: float,
    tilt_deg: float,
) -> Signal:
    """The signal and its echoes by way of the bottom."""
    return _with_images(signal, ping, -altitude_m, loss_db, tilt_deg)


def _with_images(
    signal: Signal, ping: Ping, height_m: float, loss_db: float, tilt_deg: float
) -> Signal:
    """Echoes by way of a level plane `height_m` above the sonar (negative: below)."""
    from factory.field import kernels  # loads numba

    scene = ping.scatterers
    points_m = ping.sonar.mount.to_sonar(scene.filled_camera_m).astype(np.float32)
    r, r_image, sine, sine_image = _ways(points_m, height_m, np.deg2rad(tilt_deg))

    one_way = np.sqrt(ping.vertical_pattern(sine))
    towards = np.sqrt(ping.vertical_pattern(sine_image)) / np.maximum(one_way, _FAINTEST)
    longer_m = r_image - r
    absorbed = np.exp(-np.log(10) / 10 * ping.absorption_db_per_m * longer_m)
    once = towards * (r / r_image) ** 2 * absorbed * 10 ** (-loss_db / 10)

    planes = np.concatenate([signal.power[None], signal.field.reshape(-1, *ping.shape)])
    made = planes.reshape(len(planes), -1).copy()
    kernels.mirror(
        scene.filled,
        (longer_m / ping.bin_m).astype(np.float32),
        once.astype(np.float32),
        ping.sonar.beams,
        planes.reshape(len(planes), -1),
        made,
    )
    made = made.reshape(planes.shape)
    return Signal(made[0], made[1:].reshape(signal.field.shape))


def _ways(
    points_m: Floats, height_m: float, tilt_rad: float
) -> tuple[Floats, Floats, Floats, Floats]:
    """Way to each point, way by the plane, and the sines of the elevations of their departures."""
    x, y, z = points_m.T
    ahead = x * np.cos(tilt_rad) + z * np.sin(tilt_rad)
    up = z * np.cos(tilt_rad) - x * np.sin(tilt_rad)
    up_image = 2 * height_m - up
    flat2 = ahead**2 + y**2
    r, r_image = np.sqrt(flat2 + up**2), np.sqrt(flat2 + up_image**2)
    # The direction of departure in the sonar's own axes.
    sine_image = (up_image * np.cos(tilt_rad) + ahead * np.sin(tilt_rad)) / r_image
    return r, np.maximum(r_image, r), z / r, sine_image
