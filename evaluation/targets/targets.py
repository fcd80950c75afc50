"""Moving targets of known position, size and contrast, inserted into a static recording.

A target is the smoothed scene, raised by its contrast, plus grain taken from elsewhere in the same
frame, so that no texture is synthetic.  The twin sequence gets the same grain at the same places
with zero contrast: both sequences differ in target contrast alone.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.common.array_types import Bools, Float32s
from ..metrics.measure import Grey

Frames = Float32s
"""(N, H, W) in 0..1."""

_SCENE_PX = 4.0
_GRAIN_PX = 3.0
_GRAIN_LEVEL_PX = 8.0
"""Sigmas of the blurs that give the scene, leave the grain, and average its power."""
_TINY = 1e-3 / 255  # least standard deviation of the grain
_APART_PX = 45.0  # least distance between two tracks
_ATTEMPTS = 400  # to place a track


class TargetClass(NamedTuple):
    """Size and contrast, which the targets of a class have in common.

    semi_axes_px: of the ellipse, the first along the direction of travel.
    contrast: above the scene, in standard deviations of the local grain (a single pixel's SNR).
    """

    semi_axes_px: tuple[float, float]
    contrast: float

    @property
    def label(self) -> str:
        """Name of the class in tables."""
        along, across = self.semi_axes_px
        return f"{along:g}x{across:g} px, {self.contrast:g}"


class Sighting(NamedTuple):
    """A target in one frame: its centre in pixels from the upper left corner."""

    frame: int
    y: float
    x: float


@dataclass(frozen=True)
class Track:
    """A target on a straight path at constant speed, a sighting in each frame.

    angle_rad: of its path and longer axis, from the x axis towards the y axis.
    """

    target: TargetClass
    angle_rad: float
    sightings: tuple[Sighting, ...]

    def is_apart_from(self, track: Track) -> bool:
        """Whether no position of one track is near any position of the other."""
        positions = np.array([[sighting.y, sighting.x] for sighting in self.sightings])
        track_positions = np.array([[sighting.y, sighting.x] for sighting in track.sightings])
        distances = np.linalg.norm(positions[:, None] - track_positions[None], axis=-1)
        return bool(distances.min() > _APART_PX)


@dataclass(frozen=True)
class TrackPlan:
    """What the tracks of targets are drawn from.

    classes: of the targets; they take turns.  at_once: most tracks in a frame.
    frames: length of a track; then new tracks begin elsewhere.
    speed_px: least and greatest speed, pixels per frame.
    """

    classes: tuple[TargetClass, ...]
    at_once: int
    frames: int
    speed_px: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Insertion:
    """A recording with targets, and its twin with the same grain and no contrast.

    with_targets, without: (N, H, W) float32 in 0..1, not yet rounded to levels of the file.
    """

    with_targets: Frames
    without: Frames
    tracks: tuple[Track, ...]


def classes_of(
    sizes: Sequence[tuple[float, float]], contrasts: Sequence[float]
) -> tuple[TargetClass, ...]:
    """Every size with every contrast."""
    return tuple(itertools.starmap(TargetClass, itertools.product(sizes, contrasts)))


def blurred(image: Grey, sigma_px: float) -> Grey:
    """An image after a Gaussian blur."""
    return np.asarray(cv2.GaussianBlur(np.asarray(image, np.float32), (0, 0), sigma_px))


def ellipse(
    shape: tuple[int, ...], y: float, x: float, angle_rad: float, semi_axes_px: Sequence[float]
) -> Grey:
    """(H, W) in 0..1: a soft ellipse, half its height at about .9 of its semi-axes."""
    rows, columns = np.ogrid[: shape[0], : shape[1]]
    down = rows - y
    right = columns - x
    along = right * np.cos(angle_rad) + down * np.sin(angle_rad)
    across = down * np.cos(angle_rad) - right * np.sin(angle_rad)
    squared = (along / semi_axes_px[0]) ** 2 + (across / semi_axes_px[1]) ** 2
    return np.asarray(np.exp(-(squared**2)), np.float32)


def draw_tracks(
    insonified: Bools, frame_count: int, plan: TrackPlan, rng: np.random.Generator
) -> list[Track]:
    """Tracks that stay in the insonified area and apart from each other.

    insonified: (H, W) bool, not all false.  Fewer tracks than planned where there is no room.
    """
    positions = np.argwhere(insonified)
    tracks: list[Track] = []
    for epoch, first in enumerate(range(0, frame_count, plan.frames)):
        numbers = range(first, min(first + plan.frames, frame_count))
        neighbours: list[Track] = []
        for turn in range(plan.at_once):
            target = plan.classes[(turn + epoch) % len(plan.classes)]
            for _ in range(_ATTEMPTS):
                start = positions[rng.integers(len(positions))]
                track = _straight_track(target, start, numbers, plan.speed_px, rng)
                is_free = all(track.is_apart_from(neighbour) for neighbour in neighbours)
                if is_free and _stays_inside(track, insonified):
                    neighbours.append(track)
                    break
        tracks += neighbours
    return tracks


def insert_targets(
    frames: Frames, insonified: Bools, tracks: Sequence[Track], rng: np.random.Generator
) -> Insertion:
    """The recording with the targets of all tracks, and its twin."""
    scene = blurred(frames.mean(axis=0), _SCENE_PX)
    power = np.zeros_like(scene)
    for frame in frames:
        power += _grain(frame) ** 2
    grain_std = np.sqrt(blurred(power / len(frames), _GRAIN_LEVEL_PX)) + np.float32(_TINY)
    positions = np.argwhere(insonified)
    with_targets = frames.copy()
    without = frames.copy()
    for track in tracks:
        semi_axes_px = track.target.semi_axes_px
        for number, y, x in track.sightings:
            patch = _patch_around(y, x, track.target, scene.shape)
            centre_y = y - patch[0].start
            centre_x = x - patch[1].start
            mask = ellipse(scene[patch].shape, centre_y, centre_x, track.angle_rad, semi_axes_px)
            source_y, source_x = positions[rng.integers(len(positions))]
            shift = (int(y) - int(source_y), int(x) - int(source_x))
            grain = np.roll(_grain(frames[number]) / grain_std, shift, (0, 1))[patch]
            for sequence, contrast in ((with_targets, track.target.contrast), (without, 0.0)):
                target = scene[patch] + grain_std[patch] * (np.float32(contrast) + grain)
                sequence[number][patch] = sequence[number][patch] * (1 - mask) + mask * target
    return Insertion(np.clip(with_targets, 0, 1), np.clip(without, 0, 1), tuple(tracks))


def _grain(frame: Grey) -> Grey:
    """What a blur takes away."""
    return frame - blurred(frame, _GRAIN_PX)


def _straight_track(
    target: TargetClass,
    start: npt.NDArray[np.integer],
    numbers: range,
    speed_px: tuple[float, float],
    rng: np.random.Generator,
) -> Track:
    """A track from a start in a random direction at a speed that is drawn from `speed_px`."""
    angle = float(rng.uniform(0, 2 * np.pi))
    speed = float(rng.uniform(*speed_px))
    down = speed * np.sin(angle)
    right = speed * np.cos(angle)
    sightings = tuple(
        Sighting(number, float(start[0] + down * step), float(start[1] + right * step))
        for step, number in enumerate(numbers)
    )
    return Track(target, angle, sightings)


def _stays_inside(track: Track, insonified: Bools) -> bool:
    height, width = insonified.shape
    return all(
        0 <= sighting.y < height
        and 0 <= sighting.x < width
        and insonified[int(sighting.y), int(sighting.x)]
        for sighting in track.sightings
    )


def _patch_around(
    y: float, x: float, target: TargetClass, shape: tuple[int, ...]
) -> tuple[slice, slice]:
    """Rows and columns of a target; beyond them its mask is practically zero."""
    reach = int(np.ceil(2 * max(target.semi_axes_px)))
    rows = slice(max(0, int(y) - reach), min(shape[0], int(y) + reach + 1))
    columns = slice(max(0, int(x) - reach), min(shape[1], int(x) + reach + 1))
    return rows, columns
