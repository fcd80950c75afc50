"""What depends on the device and the window alone: range bins and the vertical beam pattern."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from ...sonar import array
from ...sonar.settings import SonarSettings
from ...sonar.window import Window

Floats = npt.NDArray[np.float32]

_PATTERN_STEPS = 4096


def bin_centres_m(window: Window, sonar: SonarSettings) -> Floats:
    """(range_bins,) centres of the range bins, metres."""
    fraction = (np.arange(sonar.range_bins) + 0.5) / sonar.range_bins
    return np.asarray(window.range_min_m + fraction * window.range_span_m, np.float32)


@lru_cache(maxsize=8)
def vertical_table(sonar: SonarSettings) -> Floats:
    """(4097,) two-way vertical intensity pattern at equal steps of sin(elevation) from -1 to 1."""
    sine = np.linspace(-1, 1, _PATTERN_STEPS + 1)
    return array.vertical_pattern(sine, sonar.vfov_deg, sonar.array).astype(np.float32)
