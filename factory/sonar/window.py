"""The window of one picture: the ranges it shows and the bearings that the camera saw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .echoes import Echoes


@dataclass(frozen=True)
class Window:
    """Range and azimuth limits of one sample.

    projection: "slant_range" (what a sonar measures) or "top_view" (horizontal distance, the
        paper's view of the cloud from above).
    azimuth_min_rad, azimuth_max_rad: the part of the sonar's sector that the camera saw; outside it
        there is no data and the picture is masked.
    """

    projection: str
    range_min_m: float
    range_max_m: float
    azimuth_min_rad: float
    azimuth_max_rad: float

    @property
    def range_span_m(self) -> float:
        """Length of the range window, metres."""
        return self.range_max_m - self.range_min_m

    @property
    def near_fraction(self) -> float:
        """range_min as a fraction of range_max: what the shape of a fan depends on."""
        return self.range_min_m / self.range_max_m

    @property
    def azimuth_span_rad(self) -> float:
        """Width of the seen sector, radians."""
        return self.azimuth_max_rad - self.azimuth_min_rad

    def range_of(self, echoes: Echoes) -> npt.NDArray[np.float32]:
        """(N,) float32 range under this window's projection, metres."""
        return echoes.range_m if self.projection == "slant_range" else echoes.ground_range_m()

    def range_fraction(self, echoes: Echoes) -> npt.NDArray[np.float32]:
        """(N,) position in the range window: 0 at range_min_m, 1 at range_max_m."""
        return np.asarray((self.range_of(echoes) - self.range_min_m) / self.range_span_m)
