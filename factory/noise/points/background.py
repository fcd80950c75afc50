"""Background noise: silt, micro-organisms and other scatterers in the water (paper section 3.3.1).

r ~ U(a, b), theta ~ U(c, d), strength ~ U(0, 1): points spread evenly over range and bearing, so
their density on the ground falls as 1/r, as the paper prints it.
"""

from __future__ import annotations

import numpy as np
from pydantic.dataclasses import dataclass

from ...distribution import NonNegative, uniform
from ...imaging.effect import Effect, EffectSettings, parameter
from ...settings import STRICT
from ...sonar.echoes import Echoes, in_plane
from ...sonar.window import Window


@dataclass(frozen=True, config=STRICT)
class BackgroundSettings(EffectSettings):
    """Keys of `noise.background`.

    density: number of noise points as a fraction of the resampled scene points.
    strength: strongest noise point; 1 alone fills a bin to full scale.
    """

    density: NonNegative = parameter(uniform(0.002, 0.045), "1")
    strength: NonNegative = parameter(uniform(0.05, 0.35), "1")


def background(
    scene: Echoes, window: Window, rng: np.random.Generator, *, density: float, strength: float
) -> Echoes:
    """Noise points for `scene` (its number of points counts, not where they are)."""
    count = round(density * len(scene))
    range_m = window.range_min_m + window.range_span_m * rng.random(count, dtype=np.float32)
    azimuth_rad = window.azimuth_min_rad + window.azimuth_span_rad * rng.random(
        count, dtype=np.float32
    )
    return in_plane(range_m, azimuth_rad, strength * rng.random(count, dtype=np.float32))


BACKGROUND = Effect(BackgroundSettings, background, "points", artefact="speckle")
