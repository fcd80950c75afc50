"""The removed signal: what denoising took away, and whether that is more than grain.

It is the noisy image minus the denoised one, in standard deviations of the local grain: the ratio
image by which speckle filters are judged without a reference (Gomez, Ospina and Frery 2017), for
grain that need not be multiplicative.  Where only grain was removed, the signal smoothed to the
size of targets deviates by its usual spread everywhere.  Structure shows as a spot that deviates
much further, and as power of the smoothed signal, that is correlation between neighbours, beyond
the grain's own.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Array, UInt8s
from .temporal.motion import factors, grey_of, reduced

SHOWN = 5.0
"""Standard deviations of the grain from grey to white, and to black, where it is shown."""

_GRAIN_PX = 9  # side of the mean that the grain is measured against
_LOCAL_PX = 15  # side of the window in which the grain has one standard deviation
_LEAST_STD = 0.0015  # of the grain: less is the rounding of 8 bits
_INSONIFIED = 0.05  # part of the image's bright level below which the sonar received nothing
_BRIGHT = 0.99  # quantile of the grey values that is the bright level
_EVERY_PX = 4  # rows and columns from one pixel of that quantile to the next

_TARGET_PX = (2.0, 4.0)  # sigmas that smooth the removed signal to the size of targets
_AROUND_PX = 65  # side of the window in which the smoothed signal has one mean and one spread
_CLIPPED = 2.5  # a pixel adds at most this many mean deviations to the spread
_LEAST_SPREAD = 0.6
"""Least local spread as a part of the image's, so that ordinary grain is not reported where hardly
anything was removed."""
_MEAN_TO_STD = math.sqrt(math.pi / 2)  # mean absolute deviation to sigma of a normal distribution
_LEAST_PIXELS = 1000

_BEYOND = 4.0
"""Spreads from which on a pixel counts to the share: one in 16,000 pixels of normal grain."""
_LIMIT = 6.5
_LIMIT_RISE = 0.2
"""Limit that grain does not reach in one image, in spreads, and its increase per unit of
ln(number of images).  Measured on real recordings (docs/how-to/recordings.md): with the mean over
time as the denoised frame, 58 frames of grain reach 6.6."""


class Structure(NamedTuple):
    """The most suspicious spot of one removed signal, and how much there is beyond grain.

    row, column: of the spot, pixels.  deviation: of the smoothed signal there, in units of its
    spread; negative where the denoised image is too bright, as in a shadow that was filled.
    share: of the smoothed signal's power, the part beyond the grain's own, 0 to 1.
    """

    row: int
    column: int
    deviation: float
    share: float


@dataclass(frozen=True, eq=False)
class Removed:
    """What was removed from one image.

    noisy, denoised: (H, W) or (H, W, C) float32 in 0..1; of colours the mean counts.
    """

    noisy: Array
    denoised: Array

    @cached_property
    def signal(self) -> Array:
        """(H, W) float32: noisy minus denoised, in standard deviations of the local grain.

        0 where nothing was insonified.
        """
        difference = grey_of(self.noisy) - grey_of(self.denoised)
        return np.asarray(difference / self._grain_std * self._insonified, np.float32)

    def shown(self) -> UInt8s:
        """(H, W) uint8 to look at: grey where nothing was removed, bright where echoes were."""
        levels = 0.5 + 0.5 * np.clip(self.signal / np.float32(SHOWN), -1, 1)
        return np.asarray(np.rint(levels * 255), np.uint8)

    @cached_property
    def structure(self) -> Structure | None:
        """The most suspicious spot; None if nothing was removed or too little was insonified."""
        insonified = (reduced(self._insonified) > 0.99).astype(np.uint8)
        inside = cv2.erode(insonified, np.ones((5, 5), np.uint8)) > 0
        signal = reduced(self.signal)
        if np.count_nonzero(inside) < _LEAST_PIXELS or not signal.any():
            return None

        row_factor, column_factor = factors(self.noisy.shape)
        structures = []
        for sigma_px in _TARGET_PX:
            smooth = cv2.GaussianBlur(
                signal, (0, 0), sigma_px / column_factor, sigmaY=sigma_px / row_factor
            )
            around_px = (_AROUND_PX // column_factor | 1, _AROUND_PX // row_factor | 1)
            structures.append(_find_furthest_spot(smooth, inside, around_px))
        furthest = max(structures, key=lambda structure: abs(structure.deviation))
        share = max(structure.share for structure in structures)
        row = furthest.row * row_factor
        column = furthest.column * column_factor
        return Structure(row, column, furthest.deviation, share)

    @cached_property
    def _insonified(self) -> Array:
        """(H, W) float32: 1 where the sonar received anything, else 0."""
        level = cv2.blur(grey_of(self.noisy), (_GRAIN_PX, _GRAIN_PX))
        sampled = level[::_EVERY_PX, ::_EVERY_PX]
        sampled = sampled[sampled > 0]
        bright = float(np.quantile(sampled, _BRIGHT)) if sampled.size else 1.0
        return (level > _INSONIFIED * bright).astype(np.float32)

    @cached_property
    def _grain_std(self) -> Array:
        """(H, W): standard deviation of the noisy image around its local mean."""
        noisy = grey_of(self.noisy)
        mean = _local_mean(noisy, self._insonified, (_GRAIN_PX, _GRAIN_PX))
        power = _local_mean((noisy - mean) ** 2, self._insonified, (_LOCAL_PX, _LOCAL_PX))
        return np.asarray(np.sqrt(np.maximum(power, 0)) + np.float32(_LEAST_STD))


def _local_mean(plane: Array, inside: Array, side_px: tuple[int, int]) -> Array:
    """Mean over a window (width, height) of the pixels where `inside` is 1, else 0."""
    masked: Array = plane * inside
    share = np.maximum(cv2.blur(inside, side_px), np.float32(1e-3))
    return np.asarray(cv2.blur(masked, side_px) / share)


def _find_furthest_spot(smooth: Array, inside: Array, around_px: tuple[int, int]) -> Structure:
    """The spot of a smoothed signal, (H, W), that lies furthest from its surroundings.

    inside: (H, W) bool, where to look.  around_px: width and height of the surroundings.
    """
    mask = inside.astype(np.float32)
    deviation = (smooth - _local_mean(smooth, mask, around_px)) * mask

    # The mean is taken twice, so that a target adds little to the spread that it is measured by.
    distance = np.abs(deviation)
    mean_distance = _local_mean(distance, mask, around_px)
    clipped = np.minimum(distance, _CLIPPED * mean_distance)
    mean_distance = _local_mean(clipped, mask, around_px)
    image_rms = float(np.sqrt((mean_distance[inside] ** 2).mean()))
    least_distance = max(_LEAST_SPREAD * image_rms, 1e-6)
    spread = np.maximum(mean_distance, least_distance) * np.float32(_MEAN_TO_STD)

    score = deviation / spread
    row, column = np.unravel_index(int(np.argmax(np.abs(score))), score.shape)
    beyond = np.abs(score) > _BEYOND
    excess = float((deviation**2 - spread**2)[beyond].sum())
    share = excess / max(float((deviation**2).sum()), 1e-12)
    return Structure(int(row), int(column), float(score[row, column]), share)


class RemovedReport:
    """What was removed from all images of a run, told in a line."""

    def __init__(self) -> None:
        self._deviations: list[float] = []
        self._worst: tuple[str, Structure] | None = None

    def add(self, place: str, structure: Structure | None) -> None:
        """Add an image.  place: its name: its file, and in a recording the frame."""
        if structure is None:
            return
        self._deviations.append(abs(structure.deviation))
        if self._worst is None or abs(structure.deviation) > abs(self._worst[1].deviation):
            self._worst = place, structure

    def merge(self, other: RemovedReport, name: str) -> None:
        """Add the images of a file.  other: its report.  name: of the file."""
        self._deviations += other._deviations
        if other._worst is None:
            return
        place, structure = other._worst
        if self._worst is None or abs(structure.deviation) > abs(self._worst[1].deviation):
            self._worst = (f"{name}, {place}" if place else name), structure

    @property
    def worst(self) -> tuple[str, Structure] | None:
        """The most suspicious spot and its image; None where none could be judged."""
        return self._worst

    def limit(self) -> float:
        """Deviation of a spot that grain alone does not reach in this many images."""
        return _LIMIT + _LIMIT_RISE * math.log(max(len(self._deviations), 1))

    def summary(self) -> Iterator[str]:
        """The line, if any image could be judged."""
        if self._worst is None:
            return
        place, worst = self._worst
        limit = self.limit()
        suspicious = sum(deviation > limit for deviation in self._deviations)
        worst_place = f"{place}, row {worst.row}, column {worst.column}"
        if not suspicious:
            yield (
                "removed: no structure found beyond grain; the most suspicious spot is in "
                f"{worst_place} ({abs(worst.deviation):.1f} times the usual spread; "
                f"structure from {limit:.1f})"
            )
            return
        kind = "an echo" if worst.deviation > 0 else "a shadow"
        yield (
            f"removed: structure in {suspicious} of {len(self._deviations)} images; most "
            f"suspicious: {kind} in {worst_place} ({abs(worst.deviation):.1f} times the usual "
            f"spread; grain stays below {limit:.1f}), {100 * worst.share:.1f} % of what was "
            "removed there"
        )
