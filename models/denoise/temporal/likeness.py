"""How alike frames are in what they show and how bright they show it.

Frames are compared by thumbnails, in which grain averages out and the scene does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import cv2
import numpy as np

from ....factory.common.array_types import Array
from ...recordings.device_settings import RecordedSettings

UNLIKE = 0.05
"""Relative difference of thumbnails up to which frames are alike; of the recordings that ship,
successive frames have .013 at most, and frames of a gain of 1.2 have .09."""
SAME_GAIN = 0.04
"""Logarithm of the ratio of levels up to which frames are as bright as each other; it is .017 at
most in the recordings that ship."""
_THUMBNAIL_PX = 24  # side
_PART_PX = 8  # side of an image's part that a pixel of a thumbnail stands for, at least
_DARK = 0.01  # grey value: darker parts show nothing
_LEAST_PARTS = 10


class Likeness(NamedTuple):
    """How unlike two frames of one scene are.

    gain: factor that makes the first as bright as the second, the median ratio of small parts.
    difference: median relative difference that is left with it, 0 to 1.
    """

    gain: float
    difference: float

    @property
    def is_same_level(self) -> bool:
        """Whether both frames are as bright as each other."""
        return abs(math.log(max(self.gain, 1e-6))) <= SAME_GAIN

    @property
    def is_same_scene(self) -> bool:
        """Whether the frames differ by a gain at most."""
        return self.difference <= UNLIKE


def likeness_of(thumbnail: Array, other_thumbnail: Array) -> Likeness:
    """How unlike two thumbnails are in brightness and besides."""
    lit = np.minimum(thumbnail, other_thumbnail) > _DARK
    if np.count_nonzero(lit) < _LEAST_PARTS:
        return Likeness(1.0, difference(thumbnail, other_thumbnail))
    gain = float(np.median(other_thumbnail[lit] / thumbnail[lit]))
    return Likeness(gain, difference(thumbnail * np.float32(gain), other_thumbnail))


def difference(thumbnail: Array, other_thumbnail: Array) -> float:
    """Median relative difference of two thumbnails where one of them is lit, 0 to 1."""
    lit = np.maximum(thumbnail, other_thumbnail) > _DARK
    if np.count_nonzero(lit) < _LEAST_PARTS:
        return 0.0
    apart = np.abs(thumbnail - other_thumbnail)[lit]
    return float(np.median(apart / (thumbnail + other_thumbnail)[lit]))


def thumbnail_of(grey: Array, full_shape: tuple[int, ...] | None = None) -> Array:
    """Means of the parts of an image, (H, W).

    full_shape: of the image that it was reduced from; None: of none.
    """
    sides = full_shape or grey.shape
    height, width = (min(_THUMBNAIL_PX, max(side // _PART_PX, 1)) for side in sides[:2])
    return np.asarray(cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA), np.float32)


@dataclass(eq=False)
class _Group:
    """Frames of one kind.  thumbnail: of the newest one.  numbers: of all."""

    settings: RecordedSettings
    shape: tuple[int, ...]
    thumbnail: Array
    numbers: list[int] = field(default_factory=list)


class LikeFrames:
    """Sorts frames by their settings, and by their levels where they show one scene.

    Denoising makes up for a gain between two frames (`stream`).  A mean that serves as a reference
    or as a target cannot, so here frames of another level are another kind, too.
    compares_levels: whether frames follow each other in time, so that a step in level is a setting
        that nothing states.
    """

    def __init__(self, *, compares_levels: bool) -> None:
        self._compares_levels = compares_levels
        self._groups: list[_Group] = []
        self._count = 0

    def add(self, grey: Array, settings: RecordedSettings) -> None:
        """Take the next frame, (H, W) in 0..1."""
        thumbnail = thumbnail_of(grey)
        group = self._group_of(grey.shape, thumbnail, settings)
        if group is None:
            group = _Group(settings, grey.shape, thumbnail)
            self._groups.append(group)
        group.thumbnail = thumbnail
        group.numbers.append(self._count)
        self._count += 1

    @property
    def places(self) -> list[list[int]]:
        """Numbers of the frames of each kind, in order."""
        return [group.numbers for group in self._groups]

    def note(self, name: str) -> str:
        """A line where the frames of a recording are of several kinds; empty where they are not."""
        if len(self._groups) < 2:
            return ""
        counts = ", ".join(
            f"{len(group.numbers)} from {group.numbers[0]}" for group in self._groups
        )
        return (
            f"{name}: {len(self._groups)} kinds of frames by setting or level ({counts}); each is "
            "compared with its like alone"
        )

    def _group_of(
        self, shape: tuple[int, ...], thumbnail: Array, settings: RecordedSettings
    ) -> _Group | None:
        """The group that a frame belongs to: of like settings and level; None for a new one."""
        candidates = [
            group
            for group in self._groups
            if group.shape == shape and group.settings.is_like(settings)
        ]
        newest_first = sorted(candidates, key=lambda group: group.numbers[-1], reverse=True)
        if not self._compares_levels or not newest_first:
            return next(iter(newest_first), None)
        likenesses = [likeness_of(thumbnail, group.thumbnail) for group in newest_first]
        for group, likeness in zip(newest_first, likenesses, strict=True):
            if likeness.is_same_scene and likeness.is_same_level:
                return group
        # What shows another scene may follow a motion; only one scene tells of levels.
        return None if likenesses[0].is_same_scene else newest_first[0]
