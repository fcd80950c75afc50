"""What the clean picture of the complex field is: `acoustics.target`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...sonar import polar, transfer
from ...sonar.surface import LitSurface
from ..contract import Floats
from .beams import bin_centres_m
from .scatterers import scatterers

if TYPE_CHECKING:
    from ..contract import ImagingSettings


@dataclass(frozen=True, eq=False)
class Target:
    """The clean picture of all samples of a frame.

    grey: (range_bins, beams) float32 grey values; 0 in beams without data.
    full_scale: the intensity (of the points' echoes, or the backscatter) shown as grey value 1.
    """

    grey: Floats
    full_scale: float


def target(
    surface: LitSurface, config: ImagingSettings, amplitude: Floats, full_scale: float
) -> Target | None:
    """The target that `acoustics.target` asks for; None where it depends on the noise.

    amplitude: (range_bins, beams) float32, expected after time-varying gain.
    full_scale: the amplitude that the noisy picture shows as grey value 1.
    """
    window, sonar, name = surface.window, config.sonar, config.acoustics.target
    if name in ("mean_log", "restored"):
        return None
    if name == "mean_field":
        grey, intensity = transfer.grey(amplitude, full_scale, sonar.transfer), full_scale**2
    elif name == "geometry":
        points = polar.accumulate(surface.insonified.echoes, window, sonar)
        level = polar.spread_points(points, sonar)
        intensity = transfer.full_scale(level, sonar.transfer, "intensity")
        grey = transfer.grey(level, intensity, sonar.transfer, "intensity")
    else:
        level = np.sqrt(backscatter(surface, config))
        scale = transfer.full_scale(level, sonar.transfer)
        grey, intensity = transfer.grey(level, scale, sonar.transfer), scale**2
    return Target(polar.where_seen(grey, window, sonar), intensity)


def backscatter(surface: LitSurface, config: ImagingSettings) -> Floats:
    """(range_bins, beams) float32 backscatter cross-section per plan area of each bin, 1.

    No spreading, no absorption, no beam pattern, no point-spread: what is left of the sonar
    equation when all that a gain could undo is undone.
    """
    sonar, window = config.sonar, surface.window
    found = scatterers(
        surface.frame,
        surface.rendered,
        window,
        sonar,
        config.water,
        config.acoustics,
        patterned=False,
    )
    range_m = bin_centres_m(window, sonar)
    bin_m = window.range_span_m / sonar.range_bins
    width_rad = np.gradient(sonar.beam_centres_rad())
    area_m2 = range_m[:, None] * bin_m * width_rad
    section_m2 = found.power / found.loss[:, None] * range_m[:, None] ** 4
    return np.asarray(section_m2 / area_m2, np.float32)
