"""What the clean picture of the complex field is: `acoustics.target`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from simnfnd.factory.formation.contract import Floats
from simnfnd.factory.formation.field.scatterers import scatterers
from simnfnd.factory.formation.field.tables import bin_centres_m
from simnfnd.factory.sonar import polar, transfer
from simnfnd.factory.sonar.surface import LitSurface

if TYPE_CHECKING:
    from simnfnd.factory.config import FactoryConfig


def clean_picture(
    surface: LitSurface, config: FactoryConfig, amplitude: Floats, full_scale: float
) -> Floats:
    """(range_bins, beams) float32 grey values of the clean picture; 0 in beams without data.

    amplitude: (range_bins, beams) float32, expected after time-varying gain.
    full_scale: the amplitude that the noisy picture shows as grey value 1.
    """
    window, sonar, target = surface.window, config.sonar, config.acoustics.target
    if target == "mean_field":
        level, scale = amplitude, full_scale
    else:
        if target == "geometry":
            points = polar.accumulate(surface.insonified.echoes, window, sonar)
            level = polar.spread_points(points, sonar)
        else:
            level = np.sqrt(backscatter(surface, config))
        scale = transfer.full_scale(level, sonar.transfer)
    return polar.where_seen(transfer.grey(level, scale, sonar.transfer), window, sonar)


def backscatter(surface: LitSurface, config: FactoryConfig) -> Floats:
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
