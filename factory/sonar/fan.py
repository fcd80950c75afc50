"""Polar image -> fan image, by inverse mapping: each pixel looks up its range and azimuth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from factory.sonar.settings import SonarSettings

AnyNumber = TypeVar("AnyNumber", bound=np.generic)


@dataclass(frozen=True, eq=False)
class FanTable:
    """For each fan pixel the four polar bins around it and their bilinear weights.

    index: (4, P) flat polar bins; weight: (4, P) float32; inside: (H, W) bool sector mask; the P
    pixels are those inside, in row order.  pixel_fraction: size of a pixel as a fraction of
    range_max.
    """

    index: npt.NDArray[np.intp]
    weight: npt.NDArray[np.float32]
    inside: npt.NDArray[np.bool_]
    pixel_fraction: float

    def bilinear(self, polar: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """(H, W) float32 fan picture of a (range_bins, beams) image; 0 outside the sector."""
        flat = np.ascontiguousarray(polar, dtype=np.float32).ravel()
        fan = np.zeros(self.inside.shape, np.float32)
        fan[self.inside] = np.einsum("kp,kp->p", flat[self.index], self.weight)
        return fan

    def nearest(self, polar: npt.NDArray[AnyNumber], outside: float = 0) -> npt.NDArray[AnyNumber]:
        """(H, W) fan picture of a mask, labels or lengths, never mixed; `outside` the sector."""
        fan = np.full(self.inside.shape, outside, polar.dtype)
        best = np.take_along_axis(self.index, self.weight.argmax(axis=0)[None], axis=0)[0]
        fan[self.inside] = polar.ravel()[best]
        return fan


def pixel_size(sonar: SonarSettings, near_fraction: float) -> float:
    """Edge of a (square) fan pixel as a fraction of range_max, the sector just fitting."""
    half = np.deg2rad(sonar.hfov_deg) / 2
    width = 2 * np.sin(half)
    height = 1 - near_fraction * np.cos(half)
    return float(max(width / sonar.image.width_px, height / sonar.image.height_px))


@lru_cache(maxsize=32)
def fan_table(sonar: SonarSettings, near_fraction: float) -> FanTable:
    """The mapping for a window with range_min = near_fraction * range_max.

    Apex below the picture (or at its lower edge), far range on top, azimuth 0 in the middle.
    """
    rows, columns = sonar.image.height_px, sonar.image.width_px
    pixel = pixel_size(sonar, near_fraction)
    ahead = 1 - (np.arange(rows)[:, None] + 0.5) * pixel
    right = (np.arange(columns)[None, :] + 0.5 - columns / 2) * pixel
    range_fraction = np.hypot(ahead, right)
    azimuth_rad = np.arctan2(right, ahead)
    inside = (range_fraction >= near_fraction) & (range_fraction < 1)
    inside &= np.abs(azimuth_rad) <= np.deg2rad(sonar.hfov_deg) / 2
    row = (range_fraction[inside] - near_fraction) / (1 - near_fraction) * sonar.range_bins - 0.5
    beam = _fractional_beam(azimuth_rad[inside], sonar)
    row = np.clip(row, 0, sonar.range_bins - 1)
    row0 = np.minimum(row.astype(np.intp), sonar.range_bins - 2)
    beam0 = np.minimum(beam.astype(np.intp), sonar.beams - 2)
    u, v = row - row0, beam - beam0
    corner = row0 * sonar.beams + beam0
    index = np.stack([corner, corner + 1, corner + sonar.beams, corner + sonar.beams + 1])
    weight = np.stack([(1 - u) * (1 - v), (1 - u) * v, u * (1 - v), u * v])
    return FanTable(index, weight.astype(np.float32), inside, pixel)


def _fractional_beam(
    azimuth_rad: npt.NDArray[np.float64], sonar: SonarSettings
) -> npt.NDArray[np.float64]:
    """Position between beam centres; clamped at the outermost ones."""
    return np.interp(azimuth_rad, sonar.beam_centres_rad(), np.arange(sonar.beams))
