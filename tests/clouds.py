"""Small synthetic scenes of echoes for tests of noise and image formation."""

import numpy as np

from simnfnd.factory.common.array_types import Bools, Float64s, Floats
from simnfnd.factory.simulation.render.base import Mount
from simnfnd.factory.simulation.sonar.polar import Echoes, in_plane
from simnfnd.factory.simulation.sonar.window import Window

HALF_RAD = float(np.deg2rad(22.5))


def window(near_m=1.0, far_m=9.0, projection="slant_range", half_rad=HALF_RAD) -> Window:
    return Window(projection, near_m, far_m, -half_rad, half_rad)


def uniform_scene(count=20000, seed=0, near_m=1.0, far_m=9.0) -> Echoes:
    """Echoes spread evenly over range and bearing, strengths in (0.1, 1)."""
    rng = np.random.default_rng(seed)
    return in_plane(
        rng.uniform(near_m, far_m, count),
        rng.uniform(-HALF_RAD, HALF_RAD, count),
        rng.uniform(0.1, 1, count),
    )


def camera_scene(count=200_000, seed=0) -> Echoes:
    """What a camera of 45 x 29 degrees sees: directions even over the image, ranges 1 to 10 m."""
    rng = np.random.default_rng(seed)
    elevation_half_rad = np.deg2rad(14.5)
    return Echoes(
        rng.uniform(1, 10, count).astype(np.float32),
        rng.uniform(-HALF_RAD, HALF_RAD, count).astype(np.float32),
        rng.uniform(-elevation_half_rad, elevation_half_rad, count).astype(np.float32),
        np.ones(count, np.float32),
    )


def chosen(echoes: Echoes, mask: Bools) -> Echoes:
    return Echoes(*(values[mask] for values in vars(echoes).values()))


def to_sonar(mount: Mount, points_camera_m: Floats) -> Float64s:
    """(..., 3) points in camera axes -> the same points in sonar axes, metres."""
    offset = np.asarray(points_camera_m, np.float64) - mount.position_camera_m()
    return np.asarray(offset @ mount.rotation_sonar_from_camera().T)
