"""Which frames of a sequence belong together: of one kind, and no copies of each other.

One principle: every frame is linked to the frame before it that is most like it.  A sonar that
pings at two frequencies in turn, the channels of a stack, pings behind a title: frames of one kind
are those on one chain of links.  A copy, as a video holds of a slower sonar, is linked to its
original.  Whether a link holds depends on `LOOK` frames before and after it, so what a frame is
denoised with depends on a bounded number of frames, wherever the sequence begins.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ....factory.common.array_types import Array
from ...recordings.device_settings import RecordedSettings
from ...recordings.repeats import changed_grain, most_change_of_copies
from .likeness import difference, likeness_of, thumbnail_of

LOOK = 8
"""Frames before and after a frame that decide on its link."""
REACH = 32
"""Stored frames before and after a frame in which its window and its copies may lie."""
_MUCH_CLOSER = 0.5  # times the difference from the frame before
_CUT = 0.25  # difference of frames that do not show one scene, whatever moves

_BRIGHT = 0.125  # grey value from which on the brightest echoes of an image are bright enough
_OUTLIERS = 0.001  # part of the lit pixels that are brighter than what a scale goes by
_WANTED = 0.5
_MOST_GAIN = 2.0**14


class _Look(NamedTuple):
    """What grouping keeps of a frame.

    parent: the frame that it is linked to; None where it is like none.
    is_same_scene: whether it differs from its parent by a gain at most.
    change: part of the grain in which it differs from its parent; see `changed_grain`.
    is_little: whether so little of the grain changed that it is a copy.
    brightness: grey value of its brightest echoes; 0: it is black.
    """

    settings: RecordedSettings
    shape: tuple[int, ...]
    thumbnail: Array
    brightness: float
    parent: int | None
    is_same_scene: bool
    change: float
    is_little: bool


class Grouping:
    """The links between the frames of a sequence.

    causal: whether no frame after the one that is denoised may count.
    """

    def __init__(self, *, causal: bool) -> None:
        self._causal = causal
        self._looks: dict[int, _Look] = {}
        self._greys: dict[int, Array] = {}
        self.newest = -1

    def add(self, number: int, grey: Array, settings: RecordedSettings) -> None:
        """Take the next frame, (H, W) in 0..1."""
        thumbnail = thumbnail_of(grey)
        brightness = _brightness_of(grey)
        parent = self._most_like(number, thumbnail, grey.shape, settings)
        change = 1.0
        is_same_scene = is_little = False
        if parent is not None and parent in self._greys:
            likeness = likeness_of(thumbnail, self._looks[parent].thumbnail)
            is_same_scene = likeness.is_same_scene
            change = changed_grain(self._greys[parent], grey)
            changes = [*self._changes_before(number, parent), change]
            is_little = change <= most_change_of_copies(changes)
        self._looks[number] = _Look(
            settings, grey.shape, thumbnail, brightness, parent, is_same_scene, change, is_little
        )
        self._greys[number] = grey
        self._greys.pop(number - LOOK - 1, None)
        self._looks.pop(number - 8 * REACH, None)
        self.newest = number

    def previous(self, number: int, now: int | None = None) -> int | None:
        """The frame before one on its chain.  now: the newest frame that counts; None: all."""
        look = self._looks.get(number)
        if look is None or look.parent is None or look.parent not in self._looks:
            return None
        return look.parent if self._holds(number, now) else None

    def original(self, number: int) -> int:
        """The frame that a frame is a copy of; itself where it is none."""
        original = number
        while original > number - REACH and self.is_copy(original):
            parent = self._looks[original].parent
            assert parent is not None
            original = parent
        return original

    def is_copy(self, number: int) -> bool:
        """Whether a frame copies its parent; of long runs of copies one in a while counts."""
        if not self._changes_little(number):
            return False
        is_due = number % REACH == 0
        return not (is_due and all(map(self._changes_little, range(number - LOOK, number))))

    def before(self, number: int, count: int, now: int) -> list[int]:
        """Up to `count` originals before a frame on its chain, nearest first."""
        found: list[int] = []
        newest = self.original(number)
        while len(found) < count:
            previous = self.previous(newest, now)
            if previous is None:
                break
            newest = self.original(previous)
            if newest < number - REACH:
                break
            found.append(newest)
        return found

    def after(self, number: int, count: int) -> list[int]:
        """Up to `count` originals after a frame on its chain, nearest first."""
        found: list[int] = []
        newest = number
        while len(found) < count:
            following = self._next(newest)
            if following is None or following > number + REACH:
                break
            newest = following
            if not self.is_copy(newest):
                found.append(newest)
        return found

    def gain(self, number: int) -> float:
        """Power of two that grey values are multiplied by, so that echoes fill the grey scale.

        Samples of 10 bits in files of 16 fill a 64th of the scale, where noise and rounding cannot
        be told apart.  The brightest of some frames before on the chain decides.
        """
        brightness = 0.0
        frame: int | None = number
        for _ in range(2 * LOOK):
            if frame is None or frame < number - REACH:
                break
            brightness = max(brightness, self._looks[frame].brightness)
            frame = self.previous(frame, number)
        if brightness in (0, 1):
            return 1.0
        return float(min(2.0 ** math.floor(math.log2(_WANTED / brightness)), _MOST_GAIN))

    def _changes_before(self, number: int, parent: int) -> list[float]:
        """What changed in the frames before one on its chain, the oldest first."""
        changes: list[float] = []
        frame: int | None = parent
        while frame is not None and frame >= number - REACH and frame in self._looks:
            changes.insert(0, self._looks[frame].change)
            frame = self._looks[frame].parent
        return changes

    def _most_like(
        self, number: int, thumbnail: Array, shape: tuple[int, ...], settings: RecordedSettings
    ) -> int | None:
        """The frame that the next one is linked to."""
        candidates = [
            candidate
            for candidate in range(number - 1, number - LOOK - 1, -1)
            if candidate in self._looks
            and self._looks[candidate].shape == shape
            and self._looks[candidate].settings.is_like(settings)
        ]
        if not candidates:
            return None
        newest = candidates[0]
        # Windows make up for a gain that flickers or steps.
        if likeness_of(thumbnail, self._looks[newest].thumbnail).is_same_scene:
            return newest
        from_newest = difference(thumbnail, self._looks[newest].thumbnail)
        for candidate in candidates[1:]:
            apart = difference(thumbnail, self._looks[candidate].thumbnail)
            if apart < _MUCH_CLOSER * from_newest:
                return candidate
        return newest if from_newest <= _CUT else None

    def _holds(self, number: int, now: int | None) -> bool:
        """Whether frames do not take turns: none soon after is much closer to the parent."""
        look = self._looks[number]
        assert look.parent is not None
        if look.is_same_scene:
            return True
        thumbnail = self._looks[look.parent].thumbnail
        from_parent = difference(look.thumbnail, thumbnail)
        newest = self.newest if now is None else min(now, self.newest)
        for later in range(number + 1, min(number + LOOK, newest) + 1):
            later_look = self._looks.get(later)
            if later_look is None or later_look.parent != look.parent:
                continue
            between = difference(later_look.thumbnail, look.thumbnail)
            returned = difference(later_look.thumbnail, thumbnail)
            if returned < _MUCH_CLOSER * min(from_parent, between):
                return False
        return True

    def _next(self, number: int) -> int | None:
        """The frame after one on its chain."""
        for following in range(number + 1, min(number + LOOK, self.newest) + 1):
            look = self._looks.get(following)
            if look is not None and look.parent == number and self._holds(following, None):
                return following
        return None

    def _changes_little(self, number: int) -> bool:
        look = self._looks.get(number)
        return look is not None and look.is_little


def _brightness_of(grey: Array) -> float:
    """Grey value of the brightest echoes of an image, (H, W) in 0..1; 1 where it is enough.

    A few brighter pixels do not count: letters, or a broken receiver.
    """
    sampled = grey[::2, ::2]
    lit_count = np.count_nonzero(sampled)
    outlier_count = int(_OUTLIERS * lit_count)
    if not lit_count:
        return 0.0
    if np.count_nonzero(sampled > _BRIGHT) > outlier_count:
        return 1.0
    values = sampled[sampled > 0]
    rank = len(values) - 1 - outlier_count
    return float(np.partition(values, rank)[rank])
