"""Azimuthal artefacts: too much echo from single bearings, seen as spokes (paper section 3.3.4).

r ~ U(r_min, r_max) and theta ~ N(theta_0, sigma) around each of `count` bearings.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative, choice, uniform
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT
from ...sonar.echoes import Echoes, in_plane
from ...sonar.window import Window


@dataclass(frozen=True, config=STRICT)
class AzimuthSettings(EffectSettings):
    """Keys of `noise.azimuth`.

    count: number of spokes (rounded).
    density: points of all spokes together as a fraction of the resampled scene points.
    sigma_deg: angular width (one standard deviation) of a spoke.
    strength: strongest spoke point; 1 alone fills a bin to full scale.
    """

    count: NonNegative = parameter(choice(1, 2), "1")
    density: NonNegative = parameter(uniform(0.003, 0.02), "1")
    sigma_deg: NonNegative = parameter(uniform(0.1, 0.4), "deg")
    strength: NonNegative = parameter(uniform(0.1, 0.6), "1")


def azimuth(
    scene: Echoes,
    window: Window,
    rng: np.random.Generator,
    *,
    count: float,
    density: float,
    sigma_deg: float,
    strength: float,
) -> Echoes:
    """Spoke points at bearings drawn anywhere in the window."""
    spokes = round(count)
    points = round(density * len(scene)) if spokes else 0
    bearing_rad = window.azimuth_min_rad + window.azimuth_span_rad * rng.random(spokes)
    member = rng.integers(max(spokes, 1), size=points)
    azimuth_rad = bearing_rad[member] + np.deg2rad(sigma_deg) * rng.standard_normal(points)
    range_m = window.range_min_m + window.range_span_m * rng.random(points)
    return in_plane(range_m, azimuth_rad, strength * rng.random(points))


AZIMUTH = Effect(AzimuthSettings, azimuth, "points", artefact="spokes")
