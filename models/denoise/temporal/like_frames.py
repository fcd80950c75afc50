"""Frames that may be averaged without an alignment of their levels: those of one setting and level.

Denoising makes up for a gain between two frames (`stream`).  A mean that serves as a reference or
as a target cannot, so there frames of another level are another kind, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ....factory.common.array_types import Array
from ...recordings.device_settings import RecordedSettings
from .brightness import UNLIKE, likeness_of, thumbnail_of
from .stream import SAME_GAIN


@dataclass(eq=False)
class _Group:
    """Frames of one kind.  thumbnail: of the newest one.  places: of all."""

    settings: RecordedSettings
    shape: tuple[int, ...]
    thumbnail: Array
    places: list[int] = field(default_factory=list)


class LikeFrames:
    """Sorts frames by their settings, and by their levels where they show one scene.

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
        group.places.append(self._count)
        self._count += 1

    @property
    def places(self) -> list[list[int]]:
        """Places of the frames of each kind, in order."""
        return [group.places for group in self._groups]

    def note(self, name: str) -> str:
        """A line where the frames of a recording are of several kinds; empty where they are not."""
        if len(self._groups) < 2:
            return ""
        counts = ", ".join(f"{len(group.places)} from {group.places[0]}" for group in self._groups)
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
        newest_first = sorted(candidates, key=lambda group: group.places[-1], reverse=True)
        if not self._compares_levels or not newest_first:
            return next(iter(newest_first), None)
        likenesses = [likeness_of(thumbnail, group.thumbnail) for group in newest_first]
        for group, likeness in zip(newest_first, likenesses, strict=True):
            is_same_scene = likeness.difference <= UNLIKE
            if is_same_scene and abs(math.log(max(likeness.gain, 1e-6))) <= SAME_GAIN:
                return group
        # What shows another scene may follow a motion; only one scene tells of levels.
        shows_other = likenesses[0].difference > UNLIKE
        return newest_first[0] if shows_other else None
