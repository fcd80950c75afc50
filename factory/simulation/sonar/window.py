"""The window of one image: the ranges it shows and the bearings that the camera saw."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

from ...common import seeds
from ...common.array_types import Float32s
from ...common.errors import FrameError
from ...dataset.frame_ref import FrameRef
from .settings import SonarSettings
from .transfer import quantiles

# Ends of the automatic window: a few stray points must not decide what everybody sees.
_QUANTILES = (0.005, 0.99)
# range_min is a multiple of this fraction of range_max, so that few scan tables serve all frames.
_NEAR_STEPS = 16


class Extent(NamedTuple):
    """Where the surface is that lies in the sonar's sector, beam and range limits.

    lit_m: (N,) float32 distances of its lit pixels, as the sonar's projection measures them.
    azimuth_min_rad, azimuth_max_rad: of its pixels, lit or not.
    """

    lit_m: Float32s
    azimuth_min_rad: float
    azimuth_max_rad: float


@dataclass(frozen=True)
class Window:
    """Range and azimuth limits of one sample.

    projection: "slant_range" (what a sonar measures) or "top_view" (horizontal distance, the
        paper's view of the cloud from above).
    azimuth_min_rad, azimuth_max_rad: the part of the sonar's sector that the camera saw; outside it
        there is no data and the image is masked.
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


def set_window(sonar: SonarSettings, seed: int, ref: FrameRef) -> SonarSettings:
    """The sonar as it is set at the frame's place: with one of `sonar.range.windows_m`.

    All frames and variants of a place have the same one, so that recordings keep their window.
    """
    windows_m = sonar.range.windows_m
    if not windows_m:
        return sonar
    chosen = seeds.stream(seed, "window", ref.location, ref.scene).integers(len(windows_m))
    near_m, far_m = windows_m[int(chosen)]
    return replace(sonar, range=replace(sonar.range, min_m=near_m, max_m=far_m, windows_m=()))


def fit_window(surface: Extent, sonar: SonarSettings) -> Window:
    """The window for a frame whose measured surface is `surface`.

    Raises FrameError when no insonified surface lies in the sonar's sector and range limits.
    """
    if not len(surface.lit_m):
        raise FrameError(
            "no echo inside the sonar's sector; check sonar.hfov_deg, sonar.vfov_deg, sonar.mount "
            "and sonar.range"
        )
    near = sonar.range.min_m
    far = sonar.range.max_m
    if sonar.range.auto:
        low, high = quantiles(surface.lit_m, _QUANTILES)
        far = min(far, high * 1.05)
        steps = math.floor(_NEAR_STEPS * 0.95 * low / far)
        near = max(near, min(steps, _NEAR_STEPS - 1) / _NEAR_STEPS * far)
    return Window(sonar.projection, near, far, surface.azimuth_min_rad, surface.azimuth_max_rad)


def whole_sector(window: Window, sonar: SonarSettings) -> Window:
    """The same window with data at all bearings of the device."""
    half_rad = math.radians(sonar.hfov_deg) / 2
    return replace(window, azimuth_min_rad=-half_rad, azimuth_max_rad=half_rad)


def conical(window: Window, sonar: SonarSettings) -> Window:
    """The same window for beams that are cones: bearings that the camera saw at all elevations.

    An edge of the camera's view moves inward as `Echoes.in_conical_beams` says.  An edge of the
    device's own sector stays, for the camera sees beyond it.
    """
    half_rad = math.radians(sonar.hfov_deg) / 2
    narrower = math.cos(math.radians(sonar.vfov_deg) / 2)
    left, right = (
        edge if abs(edge) >= 0.999 * half_rad else math.asin(math.sin(edge) * narrower)
        for edge in (window.azimuth_min_rad, window.azimuth_max_rad)
    )
    return replace(window, azimuth_min_rad=left, azimuth_max_rad=right)
