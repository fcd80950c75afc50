"""Fit the window of a picture to what the camera measured."""

from __future__ import annotations

import math

from simnfnd.factory.errors import FrameError
from simnfnd.factory.sonar.quantile import quantiles
from simnfnd.factory.sonar.settings import SonarSettings
from simnfnd.factory.sonar.surface import Extent
from simnfnd.factory.sonar.window import Window

# Ends of the automatic window: a few stray points must not decide what everybody sees.
_QUANTILES = (0.005, 0.99)
# range_min is a multiple of this fraction of range_max, so that few scan tables serve all frames.
_NEAR_STEPS = 16


def fit_window(surface: Extent, sonar: SonarSettings) -> Window:
    """The window for a frame whose measured surface is `surface`.

    Raises FrameError when no insonified surface lies in the sonar's sector and range limits.
    """
    if not len(surface.lit_m):
        raise FrameError(
            "no echo inside the sonar's sector; check sonar.hfov_deg, sonar.vfov_deg, sonar.mount "
            "and sonar.range"
        )
    near, far = sonar.range.min_m, sonar.range.max_m
    if sonar.range.auto:
        low, high = quantiles(surface.lit_m, _QUANTILES)
        far = min(far, high * 1.05)
        steps = math.floor(_NEAR_STEPS * 0.95 * low / far)
        near = max(near, min(steps, _NEAR_STEPS - 1) / _NEAR_STEPS * far)
    return Window(sonar.projection, near, far, surface.azimuth_min_rad, surface.azimuth_max_rad)
