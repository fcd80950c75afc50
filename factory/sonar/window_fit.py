"""Fit the window of a picture to what the camera measured."""

from __future__ import annotations

import math

import numpy as np

from factory.echoes import Echoes
from factory.errors import FrameError
from factory.sonar.settings import SonarSettings
from factory.sonar.window import Window

# Ends of the automatic window: a few stray points must not decide what everybody sees.
_QUANTILES = (0.005, 0.99)
# range_min is a multiple of this fraction of range_max, so that few scan tables serve all frames.
_NEAR_STEPS = 16


def fit_window(surface: Echoes, sonar: SonarSettings) -> Window:
    """The window for a frame whose measured surface (in shadow or not) is `surface`.

    Raises FrameError when no insonified surface lies in the sonar's sector and range limits.
    """
    half_rad = np.deg2rad(sonar.hfov_deg) / 2
    seen = Window(sonar.projection, sonar.range.min_m, sonar.range.max_m, -half_rad, half_rad)
    fraction = seen.range_fraction(surface)
    inside = (fraction >= 0) & (fraction < 1) & (np.abs(surface.azimuth_rad) <= half_rad)
    lit = inside & (surface.strength > 0)
    if not lit.any():
        raise FrameError(
            "no echo inside the sonar's sector; check sonar.hfov_deg, sonar.vfov_deg, sonar.mount "
            "and sonar.range"
        )
    azimuth_rad = surface.azimuth_rad[inside]
    near, far = sonar.range.min_m, sonar.range.max_m
    if sonar.range.auto:
        low, high = np.quantile(seen.range_of(surface)[lit], _QUANTILES)
        far = min(far, float(high) * 1.05)
        steps = math.floor(_NEAR_STEPS * 0.95 * float(low) / far)
        near = max(near, min(steps, _NEAR_STEPS - 1) / _NEAR_STEPS * far)
    return Window(sonar.projection, near, far, float(azimuth_rad.min()), float(azimuth_rad.max()))
