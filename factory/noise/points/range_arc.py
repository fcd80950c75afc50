"""Range arcs: echoes smeared over all bearings at one range.

A strong return leaks through the sidelobes into every beam of its range row (HoloOcean calls this
an azimuth streak).  The counterpart of the spokes of `noise.azimuth`; off unless `count` says so.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT
from ...sonar.echoes import Echoes, in_plane
from ...sonar.window import Window


@dataclass(frozen=True, config=STRICT)
class RangeArcSettings(EffectSettings):
    """Keys of `noise.range_arc`.

    count: number of arcs (rounded).
    density: points of all arcs together as a fraction of the resampled scene points.
    sigma: thickness (one standard deviation) of an arc as a fraction of the range window.
    strength: strongest arc point; 1 alone fills a bin to full scale.
    """

    count: NonNegative = parameter(0, "1")
    density: NonNegative = parameter(0.02, "1")
    sigma: NonNegative = parameter(0.003, "1")
    strength: NonNegative = parameter(0.5, "1")


def range_arc(
    scene: Echoes,
    window: Window,
    rng: np.random.Generator,
    *,
    count: float,
    density: float,
    sigma: float,
    strength: float,
) -> Echoes:
    """Arc points at ranges drawn among the scene's strong echoes."""
    arcs = round(count)
    points = round(density * len(scene)) if arcs else 0
    total = float(scene.strength.sum(dtype=np.float64))
    if not points or total <= 0:
        empty = np.empty(0, np.float32)
        return in_plane(empty, empty, empty)
    probability = scene.strength.astype(np.float64) / total
    source = rng.choice(len(scene), size=arcs, p=probability / probability.sum())
    member = rng.integers(arcs, size=points)
    centre_m = window.range_of(scene)[source]
    range_m = centre_m[member] + sigma * window.range_span_m * rng.standard_normal(points)
    azimuth_rad = window.azimuth_min_rad + window.azimuth_span_rad * rng.random(points)
    return in_plane(range_m, azimuth_rad, strength * rng.random(points))


RANGE_ARC = Effect(RangeArcSettings, range_arc, "points", artefact="spokes")
