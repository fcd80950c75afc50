"""Polar image -> fan image, by inverse mapping: each pixel looks up its range and azimuth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import numpy.typing as npt

from ...common.array_types import Bools, Float32s, Floats, Int32s
from ...dataset.fan_geometry import pixel_size

if TYPE_CHECKING:  # settings load pydantic, which images of real sonars can do without
    from .settings import SonarSettings
    from .window import Window

_LARGEST_PX = 1536  # of an enlarged image

AnyNumber = TypeVar("AnyNumber", bound=np.generic)


@dataclass(frozen=True, eq=False)
class FanTable:
    """The four polar bins around each fan pixel of the sector, and its place between them.

    pixel: (P,) int32 flat fan pixels, in order.  corner: (P,) int32 flat polar bin nearest to the
    sonar and furthest left.  down, across: (P,) float32 fractions of the way to the next range bin
    and to the next beam.  inside: (H, W) bool sector mask.  beams: columns of the polar image.
    """

    pixel: Int32s
    corner: Int32s
    down: Float32s
    across: Float32s
    inside: Bools
    beams: int

    def bilinear(self, polar: Floats) -> Float32s:
        """(H, W) float32 fan image of a (range_bins, beams) image; 0 outside the sector."""
        from . import kernels  # loads numba

        fan = np.zeros(self.inside.shape, np.float32)
        source = np.ascontiguousarray(polar, dtype=np.float32)
        places = self.pixel, self.corner, self.down, self.across
        kernels.bilinear(source, *places, fan.reshape(-1))
        return fan

    def nearest(self, polar: npt.NDArray[AnyNumber], outside: float = 0) -> npt.NDArray[AnyNumber]:
        """(H, W) fan image of a mask, labels or lengths, never mixed; `outside` the sector."""
        bins = np.append(polar.ravel(), np.asarray([outside], polar.dtype))
        # An index of -1 is that of `outside`.
        return np.asarray(bins.take(self.best, mode="wrap"))

    @cached_property
    def best(self) -> npt.NDArray[np.intp]:
        """(H, W) flat polar bin whose centre is nearest in range and bearing, -1 outside."""
        best = np.full(self.inside.shape, -1)
        best[self.inside] = self.corner + (self.down > 0.5) * self.beams + (self.across > 0.5)
        return best


@lru_cache(maxsize=32)
def fan_table(sonar: SonarSettings, near_fraction: float) -> FanTable:
    """The mapping for a window with range_min = near_fraction * range_max.

    Apex below the image (or at its lower edge), far range on top, azimuth 0 in the middle.
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
    # Clamped at the outermost beams.
    beam = np.interp(azimuth_rad[inside], sonar.beam_centres_rad(), np.arange(sonar.beams))
    row = np.clip(row, 0, sonar.range_bins - 1)
    row0 = np.minimum(row.astype(np.int32), sonar.range_bins - 2)
    beam0 = np.minimum(beam.astype(np.int32), sonar.beams - 2)
    pixels = np.flatnonzero(inside)
    corner = row0 * sonar.beams + beam0
    between = (row - row0).astype(np.float32), (beam - beam0).astype(np.float32)
    places = pixels.astype(np.int32), corner.astype(np.int32), *between
    return FanTable(*places, inside, sonar.beams)


def lay_out(grey: Float32s, window: Window, sonar: SonarSettings) -> Float32s:
    """A polar image in the layout that was asked for; 0 outside the sector of a fan."""
    if sonar.image.layout == "polar":
        return grey
    return fan_table(sonar, window.near_fraction).bilinear(grey)


def rasterised(grey: Float32s, window: Window, sonar: SonarSettings, *, noisy: bool) -> Float32s:
    """`lay_out` as makers' programs do it, by sampling, enlargement and JPEG of `sonar.image`.

    Returns (H, W) float32 in 0..1, rounded to 8 bits.  noisy: whether JPEG leaves its traces.
    """
    image = sonar.image
    height, width = sonar.shape()
    laid_out = grey
    if image.layout == "fan":
        factor = max(min(image.enlarged, _LARGEST_PX / max(height, width)), 1.0)
        rows = round(height * factor)
        columns = round(width * factor)
        large = replace(sonar, image=replace(image, height_px=rows, width_px=columns))
        table = fan_table(large, window.near_fraction)
        laid_out = table.nearest(grey) if image.sampling == "nearest" else table.bilinear(grey)
    if laid_out.shape != (height, width):
        import cv2  # not in a core installation

        shrunk = cv2.resize(laid_out, (width, height), interpolation=cv2.INTER_AREA)
        laid_out = np.asarray(shrunk, np.float32)
    eight = np.rint(np.clip(laid_out, 0, 1) * 255).astype(np.uint8)
    if noisy and image.jpeg_quality is not None:
        import cv2

        _, content = cv2.imencode(".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, image.jpeg_quality])
        eight = np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), np.uint8)
    return np.asarray(eight, np.float32) / np.float32(255)


def lay_out_nearest(
    image: npt.NDArray[AnyNumber], window: Window, sonar: SonarSettings
) -> npt.NDArray[AnyNumber]:
    """A polar mask, label or length image in the layout that was asked for, never mixed.

    Outside the sector of a fan: NaN for lengths, 0 for the others.
    """
    if sonar.image.layout == "polar":
        return image
    outside = np.nan if image.dtype.kind == "f" else 0
    return fan_table(sonar, window.near_fraction).nearest(image, outside)
