"""What lies along bearings, drawn into training images: interference, and what looks like it.

Interference (spokes) is in the noisy image alone.  Walls, piles and ropes seen end on, beam
patterns, haze and steps of gain between bearings are in the clean image too, so that a network
learns to keep them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Float32s, Int64s
from ...factory.common.seeds import stream
from .pairs import ImageSource, TrainingImage

_PLACES = 1024  # of tables over range and over bearing
_GAIN_SHARE = 0.3  # of the images; each line below counts by itself
_HAZE_SHARE = 0.2
_WALL_SHARE = 0.4
_SPOKE_SHARE = 0.5
_DARK_SHARE = 0.15  # of the images with spokes whose scene is dark beside them
_SPOKE_WIDTHS_DEG = (0.15, 13.0)  # at half of the level
_WALL_WIDTHS_DEG = (0.3, 12.0)
_OWN_GRAIN_WIDTH_DEG = 2.0  # up to which the grain of a spoke may differ from bearing to bearing
_WIDEST = 0.75  # of the sector
_LEVELS = (0.04, 1.0)
_FWHM = 2.355  # standard deviations
_BLACK = 0.02  # grey value up to which there may be shadow


class _Frame(NamedTuple):
    """An image's sector: of each pixel the places in tables over range and bearing, (H, W).

    span_deg: of the bearings.  looks: frames whose speckle is averaged.
    """

    range_place: Int64s
    bearing_place: Int64s
    inside: Float32s
    span_deg: float
    looks: float


def with_radial(sample: TrainingImage, rng: np.random.Generator) -> TrainingImage:
    """The sample with what is drawn along bearings, and its noisy image without interference.

    An image of unknown geometry stays as it is.
    """
    frame = _frame_of(sample)
    if frame is None:
        return sample
    noisy = sample.noisy
    clean = sample.clean
    if rng.random() < _GAIN_SHARE:
        gain = _bearing_gain(rng, frame.span_deg)[frame.bearing_place]
        noisy = noisy * gain
        clean = clean * gain
    if rng.random() < _HAZE_SHARE:
        haze = _haze(rng, frame)
        noisy = noisy + haze * _speckle(rng, frame, haze.shape)
        clean = clean + haze
    if rng.random() < _WALL_SHARE:
        for _ in range(int(rng.integers(1, 4))):
            wall, speckle = _wall(rng, frame)
            noisy = noisy + wall * speckle
            clean = clean + wall
    has_spokes = rng.random() < _SPOKE_SHARE
    if has_spokes and rng.random() < _DARK_SHARE:
        dark = np.float32(rng.uniform(0.1, 0.7))
        noisy = dark * noisy
        clean = dark * clean
    undisturbed = np.clip(noisy, 0, 1).astype(np.float32)
    noisy = undisturbed
    if has_spokes:
        for _ in range(int(rng.choice([1, 1, 1, 2, 3]))):
            noisy = noisy + _spoke(rng, frame)
    clean = np.clip(clean, 0, 1).astype(np.float32)  # NaN, an unknown reference, stays
    shadow = sample.shadow
    if shadow is not None:
        shadow = np.where(clean > _BLACK, np.float32(0), shadow)
    noisy = np.clip(noisy, 0, 1).astype(np.float32)
    return replace(sample, noisy=noisy, clean=clean, shadow=shadow, undisturbed=undisturbed)


class RadialSource(ImageSource):
    """The images of a source for validation, each always with the same drawn along its bearings."""

    images: ImageSource

    def __init__(self, source: ImageSource, seed: int) -> None:
        self.images = source
        self.seed = seed

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """See `ImageSource`."""
        rng = stream(self.seed, "radial", "validation", index)
        return with_radial(self.images.sample(index, visit), rng)


def _frame_of(sample: TrainingImage) -> _Frame | None:
    if sample.geometry is None:
        return None
    maps = sample.geometry.maps(0, 0, *sample.noisy.shape)
    inside = maps["sector"] > 0
    if not inside.any():
        return None

    def places(values: Float32s) -> Int64s:
        low = values[inside].min()
        step = (values - low) / max(values[inside].max() - low, 1e-6)
        return np.asarray(np.clip(step * _PLACES, 0, _PLACES - 1), np.int64)

    azimuth = maps["azimuth_rad"]
    span_deg = float(np.degrees(np.ptp(azimuth[inside])))
    frames = 1.0 if sample.frames is None else float(np.exp2(np.median(sample.frames)))
    range_place = places(maps["range_fraction"])
    return _Frame(range_place, places(azimuth), inside.astype(np.float32), span_deg, frames)


def _spoke(rng: np.random.Generator, frame: _Frame) -> Float32s:
    """Interference along one bearing over all ranges, (H, W)."""
    width_deg = _width_deg(rng, *_SPOKE_WIDTHS_DEG)
    across = _bell(rng, frame.span_deg, width_deg, is_flat=rng.random() < 0.2)
    places = np.linspace(0, 1, _PLACES)
    shape = rng.integers(4)
    if shape == 0:
        along = np.ones(_PLACES)
    elif shape == 1:
        along = rng.uniform(0.1, 0.5) + places ** rng.uniform(0.7, 2)
    elif shape == 2:
        along = np.interp(places, np.linspace(0, 1, 9), rng.uniform(0.5, 1, 9))
    else:
        along = np.interp(places, [0, 1], rng.uniform(0.3, 1, 2))
    level = _log_uniform(rng, *_LEVELS) / along.max()
    speckle: Float32s = np.ones(1, np.float32)
    if width_deg < _OWN_GRAIN_WIDTH_DEG and rng.random() < 0.5:
        speckle = _speckle(rng, frame, frame.inside.shape)
    else:
        along = along * _common_speckle(rng, frame)
    return _laid(level * along, across, frame) * speckle


def _wall(rng: np.random.Generator, frame: _Frame) -> tuple[Float32s, Float32s]:
    """An echo along one bearing that begins and ends, and its speckle, (H, W) each."""
    width_deg = _width_deg(rng, *_WALL_WIDTHS_DEG)
    across = _bell(rng, frame.span_deg, width_deg, is_flat=rng.random() < 0.4)
    length = rng.uniform(0.06, 0.55)
    start = rng.uniform(-0.05, 1.05 - length)
    edge = _log_uniform(rng, 0.002, 0.05)
    places = np.linspace(0, 1, _PLACES)
    rise = np.clip((places - start) / edge + 0.5, 0, 1)
    fall = np.clip((start + length - places) / edge + 0.5, 0, 1)
    level = _log_uniform(rng, *_LEVELS)
    wall = _laid(level * rise * fall, across, frame)
    if rng.random() < 0.5:
        return wall, _common_speckle(rng, frame)[frame.range_place]
    return wall, _speckle(rng, frame, wall.shape)


def _bearing_gain(rng: np.random.Generator, span_deg: float) -> Float32s:
    """What each bearing is multiplied by: a beam pattern, or steps between bearings, (_PLACES,)."""
    if rng.random() < 0.4:
        scale = _log_uniform(rng, 1, 30) / span_deg * _PLACES
        pattern = _smooth_noise(rng, scale)
        return np.asarray(np.exp(rng.uniform(0.05, 0.5) * pattern), np.float32)
    places = np.arange(_PLACES)
    decibels = np.zeros(_PLACES)
    for _ in range(int(rng.integers(1, 4))):
        edge = _log_uniform(rng, 0.05, 6) / span_deg * _PLACES
        step = np.clip((places - rng.uniform(0, _PLACES)) / edge + 0.5, 0, 1)
        decibels += rng.uniform(-11, 7) * (step if rng.random() < 0.5 else 1 - step)
    return (10 ** (decibels / 20)).astype(np.float32)


def _haze(rng: np.random.Generator, frame: _Frame) -> Float32s:
    """Light over wide sectors, (H, W)."""
    across = 0.5 + 0.5 * _smooth_noise(rng, rng.uniform(5, 40) / frame.span_deg * _PLACES)
    nodes = rng.uniform(0, 1, int(rng.integers(2, 6)))
    along = np.interp(np.linspace(0, 1, _PLACES), np.linspace(0, 1, len(nodes)), nodes)
    return _laid(_log_uniform(rng, 0.02, 0.3) * along, np.clip(across, 0, 2), frame)


def _laid(along: Float32s, across: Float32s, frame: _Frame) -> Float32s:
    """A table over range times one over bearing, at the pixels of the sector."""
    tables = (np.asarray(table, np.float32) for table in (along, across))
    of_range, of_bearing = tables
    return of_range[frame.range_place] * of_bearing[frame.bearing_place] * frame.inside


def _bell(
    rng: np.random.Generator, span_deg: float, width_deg: float, *, is_flat: bool
) -> Float32s:
    """A profile across a bearing anywhere in the sector, (_PLACES,); flat on top, or a Gaussian."""
    bearing_deg = np.linspace(0, span_deg, _PLACES)
    offset = bearing_deg - rng.uniform(0, span_deg)
    width_deg = min(width_deg, _WIDEST * span_deg)
    exponent = 3.0 if is_flat else 1.0
    scaled = np.square(offset / (width_deg / _FWHM)) / 2
    return np.asarray(np.exp(-np.minimum(scaled**exponent, 60)), np.float32)


def _common_speckle(rng: np.random.Generator, frame: _Frame) -> Float32s:
    """Speckle along range that is alike at all bearings, mean 1, (_PLACES,)."""
    shape = _log_uniform(rng, 1.5, 20) * frame.looks
    count = int(rng.uniform(200, _PLACES))
    level = rng.gamma(shape, 1 / shape, count).astype(np.float32)
    sigma = _log_uniform(rng, 0.4, 4)
    level = cv2.GaussianBlur(level[None], (0, 0), sigma)[0]
    return np.interp(np.linspace(0, 1, _PLACES), np.linspace(0, 1, count), level).astype(np.float32)


def _speckle(rng: np.random.Generator, frame: _Frame, shape: tuple[int, ...]) -> Float32s:
    """Speckle of single pixels, or of neighbouring ones alike, mean 1, (H, W)."""
    looks = _log_uniform(rng, 2, 16) * frame.looks
    speckle: Float32s = rng.gamma(looks, 1 / looks, shape).astype(np.float32)
    if rng.random() < 0.5:
        sigmas = rng.uniform(0.3, 1.2, 2)
        blurred = cv2.GaussianBlur(speckle, (0, 0), sigmas[0], sigmaY=sigmas[1])
        speckle = np.asarray(blurred, np.float32)
    return speckle


def _smooth_noise(rng: np.random.Generator, scale: float) -> Float32s:
    """Gaussian noise along bearings, standard deviation about 1, alike over `scale` places."""
    count = max(3, int(_PLACES / scale) + 3)
    values = rng.standard_normal(count).astype(np.float32)
    start = rng.uniform(0, 1)
    at = start + np.linspace(0, count - 2, _PLACES)
    curve = cv2.resize(values[None], (count * 16, 1), interpolation=cv2.INTER_CUBIC)[0]
    return np.interp(at, (np.arange(count * 16) + 0.5) / 16, curve).astype(np.float32)


def _width_deg(rng: np.random.Generator, low: float, high: float) -> float:
    """A width: half of them even in the logarithm, half as they are."""
    return _log_uniform(rng, low, high) if rng.random() < 0.5 else float(rng.uniform(low, high))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
