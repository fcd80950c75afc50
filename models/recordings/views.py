"""Frames as they are shown: a ping as a fan, far range on top, and bright enough.

Samples of 12 bits in files of 16, and amplitudes without a logarithm, fill a small part of the grey
scale.  Networks take what is that dark for shadow, or for another kind of noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...factory.common.array_types import Float32s, Floats
from ...factory.common.errors import FactoryError
from ...factory.dataset.fan_geometry import FanGeometry
from ...factory.simulation.sonar.fan import fan_table
from . import DATASET, kind_of, open_recording
from .base import FULL_SCALE, Beams, SonarFrame, white_of
from .device_settings import RecordedSettings, settings_in_name, settings_of

if TYPE_CHECKING:
    from ...factory.simulation.sonar.settings import SonarSettings


MOST_ROWS = 1024
_FRAMES_LOOKED_AT = 5
_MOST_SIDE = 2048


def grey_of(frame: SonarFrame) -> Float32s:
    """The samples as float32 in 0..1, in the shape that they have."""
    return frame.samples.astype(np.float32) / np.float32(FULL_SCALE[str(frame.samples.dtype)])


def polar_geometry(beams: Beams, ranges: int) -> FanGeometry:
    """Geometry of the samples as they are: one row per range, one column per beam."""
    left, right = _edges_rad(beams)
    return FanGeometry(
        "polar",
        near_fraction=beams.range_min_m / beams.range_max_m,
        sector_rad=2 * max(-left, right),
        azimuth_min_rad=left,
        azimuth_max_rad=right,
        range_min_m=beams.range_min_m,
        range_max_m=beams.range_max_m,
        range_bins=ranges,
        beam_azimuths_rad=beams.azimuths_rad,
    )


def fan_of(samples: Floats, beams: Beams) -> tuple[Float32s, FanGeometry]:
    """(ranges, beams) -> (H, W) float32 fan with its geometry, far range on top, 0 outside.

    A pixel is as long as a sample where that makes at most `MOST_ROWS` pixels ahead.
    """
    sonar = _sonar(beams, *samples.shape)
    window = (beams.range_min_m, beams.range_max_m)
    geometry = FanGeometry.from_sonar(sonar, *window, *_edges_rad(beams))
    image = fan_table(sonar, window[0] / window[1]).bilinear(samples)
    # The sector of the beams need not be symmetric, the table's is.
    return image * geometry.maps(0, 0, *image.shape)["sector"], geometry


@lru_cache(maxsize=8)
def _sonar(beams: Beams, ranges: int, count: int) -> SonarSettings:
    from ...factory.simulation.sonar.settings import ImageSettings, SonarSettings  # load pydantic

    half = max(abs(edge) for edge in _edges_rad(beams))
    near = beams.range_min_m / beams.range_max_m
    pixel = (1 - near) / min(ranges, MOST_ROWS)
    sides = 2 * math.sin(half) / pixel, (1 - near * math.cos(half)) / pixel
    shrink = min(1.0, _MOST_SIDE / max(sides))
    width, height = (max(2, math.ceil(side * shrink)) for side in sides)
    return SonarSettings(
        name="recording",
        hfov_deg=min(2 * math.degrees(half), 180.0),
        beams=count,
        range_bins=ranges,
        beam_azimuths_deg=tuple(math.degrees(value) for value in beams.azimuths_rad),
        image=ImageSettings(width_px=width, height_px=height),
    )


def _edges_rad(beams: Beams) -> tuple[float, float]:
    """Outer edges of the outermost beams, which reach as far out as to their neighbours."""
    centres = beams.azimuths_rad
    left = centres[0] - (centres[1] - centres[0]) / 2
    right = centres[-1] + (centres[-1] - centres[-2]) / 2
    return max(left, -math.pi / 2), min(right, math.pi / 2)


_opened = lru_cache(maxsize=1)(open_recording)  # the last stays open for its next frame


@lru_cache(maxsize=1)
def _frame_at(path: Path, number: int) -> SonarFrame:
    """A frame whose image and settings are asked for one after the other."""
    return _opened(path)[number]


def frame_settings(path: Path, number: int) -> RecordedSettings:
    """The settings that a frame states; of an image file those in its name.

    Raises FactoryError when it cannot be read.
    """
    if kind_of(path) == "images":
        return settings_in_name(path.name)
    return settings_of(_frame_at(path, number))


def frame_image(path: Path, number: int) -> tuple[Float32s, FanGeometry | None]:
    """(H, W) float32 in 0..1, a ping as a fan; and the geometry, None where the file has none.

    Colours are the levels of their map, else luminance.  Samples of few bits in 16 are as bright as
    they look, see `white_of`.  Raises FactoryError when it cannot be read.
    """
    frame = _frame_at(path, number)
    grey = grey_of(frame)
    if frame.samples.dtype == np.uint16:
        white = max(white_of_recording(path), white_of(frame.samples))
        grey = frame.samples.astype(np.float32) / np.float32(white)
    if not np.isfinite(grey).all():
        raise FactoryError(f"{path}: frame {number} has NaN or infinite pixels")
    if frame.beams is not None:
        return fan_of(grey, frame.beams)
    if grey.ndim == 3:
        from .palettes import grey_of_colours  # needs an extra

        grey = grey_of_colours(grey)
    return np.ascontiguousarray(np.clip(grey, 0, 1)), frame.geometry


def read_grey(path: Path) -> Float32s:
    """(H, W) float32 in 0..1 of an image file, as `frame_image` gives it; the way to open one.

    Raises FactoryError when it cannot be read.
    """
    return frame_image(path, 0)[0]


@lru_cache(maxsize=64)
def white_of_recording(path: Path) -> float:
    """The white of samples of 16 bits, one for all frames of a recording.

    A few of them are looked at.  Datasets and videos state how deep their samples are, and are
    stored at full scale.
    """
    if kind_of(path) in (DATASET, "video"):
        return FULL_SCALE["uint16"]
    recording = _opened(path)
    numbers = np.linspace(0, len(recording) - 1, min(len(recording), _FRAMES_LOOKED_AT))
    return max(white_of(recording[int(number)].samples) for number in numbers)


_SHARE = 99.5  # percentile of the pixels that are not zero
# Bright pixels below the first make an image dark; below the second they come to the last.
_DARK = 0.5
_DARKER = 0.25
_WANTED = 1.0


@dataclass(frozen=True)
class Presentation:
    """What is done to an image before networks see it, and undone after."""

    quarter_turns: int  # counter-clockwise
    gain: np.float32  # what the image is multiplied by
    geometry: FanGeometry | None  # of the image that networks see; None where it is not known

    def shown(self, grey: Float32s) -> Float32s:
        """An image, (H, W) in 0..1, as networks see it; those beside it in time are alike."""
        if self.quarter_turns:
            grey = np.ascontiguousarray(np.rot90(grey, self.quarter_turns))
        return grey if self.gain == 1 else np.minimum(grey * self.gain, 1)

    def undone(self, grey: Float32s) -> Float32s:
        """The inverse of `shown`."""
        if self.gain != 1:
            grey = grey / self.gain
        if self.quarter_turns:
            grey = np.ascontiguousarray(np.rot90(grey, -self.quarter_turns))
        return grey


def presentation_of(grey: Float32s, geometry: FanGeometry | None) -> Presentation:
    """How an image, (H, W) in 0..1, is to be shown; most are left as they are.

    The gain rises without a step as images get darker, and no pixel comes above 1.
    """
    turns = 0 if geometry is None else geometry.quarter_turns
    gain = 1.0
    if geometry is not None and turns:
        geometry = geometry.turned(*grey.shape)
    # Most images are bright enough, and counting takes a fiftieth of what a percentile does.
    if np.count_nonzero(grey >= _DARK) < np.count_nonzero(grey) * (1 - _SHARE / 100):
        lit = grey[grey > 0]
        bright = max(float(np.percentile(lit, _SHARE)), 1e-6)
        gain = _WANTED / bright if bright < _DARKER else (_DARK / bright) ** 2
        gain = max(1.0, min(gain, 1 / float(lit.max())))
    return Presentation(turns, np.float32(gain), geometry)
