"""What the rows and columns of an image mean, in metres and degrees where they are fixed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...dataset.fan_geometry import pixel_size
from ...dataset.schema import Axis
from ..sonar.settings import SonarSettings


class ImageAxes(NamedTuple):
    """The axes of an image: along its rows from the top, along its columns from the left."""

    rows: Axis
    columns: Axis


def image_axes(sonar: SonarSettings) -> ImageAxes:
    """Return the row and column axes of the images.

    With one fixed range window they are metres (and degrees of azimuth for polar images).  With an
    automatic window, or several, every sample has its own scale: the axes count from 0 to 1 or in
    pixels, which `range_min_m`, `range_max_m`, `metres_per_pixel` of the table turn into metres.
    """
    if sonar.image.layout == "polar":
        return _polar_axes(sonar)
    return _fan_axes(sonar)


def _polar_axes(sonar: SonarSettings) -> ImageAxes:
    row_count, _ = sonar.shape()
    fraction = (np.arange(row_count) + 0.5) / sonar.range_bins
    azimuth = Axis("azimuth", "deg", np.rad2deg(sonar.beam_centres_rad()), "0 is straight ahead")
    if not sonar.range.fixed:
        return ImageAxes(
            Axis("range", "1", fraction, "0 at range_min_m, 1 at range_max_m"), azimuth
        )
    near_m = sonar.range.min_m
    far_m = sonar.range.max_m
    return ImageAxes(Axis("range", "m", near_m + fraction * (far_m - near_m)), azimuth)


def _fan_axes(sonar: SonarSettings) -> ImageAxes:
    row_count, column_count = sonar.shape()
    row_px = np.arange(row_count) + 0.5
    right_px = np.arange(column_count) + 0.5 - sonar.image.width_px / 2
    if not sonar.range.fixed:
        return ImageAxes(
            Axis("ahead", "px", row_px, "distance below range_max_m straight ahead"),
            Axis("right", "px", right_px, "distance to the right of the sonar's axis"),
        )
    far_m = sonar.range.max_m
    pixel_m = far_m * pixel_size(sonar, sonar.range.min_m / far_m)
    return ImageAxes(
        Axis("ahead", "m", far_m - row_px * pixel_m), Axis("right", "m", right_px * pixel_m)
    )
