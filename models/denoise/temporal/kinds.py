"""Frames of several kinds in one sequence: which of them show the scene in the same way.

A sonar pings at two frequencies in turn, an operator changes the gain, a stack holds channels.
Where the recording states settings, unlike ones are kinds.  Where it does not, frames that take
turns give themselves away: one is much less like the frame before it than like an earlier one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ....factory.common.array_types import Array
from ...recordings.device_settings import RecordedSettings
from .brightness import UNLIKE, difference, gain_of, likeness_of, thumbnail_of
from .motion import grey_of
from .stream import SequenceFrame

_MUCH_CLOSER = 0.5  # times the difference from the frame before
_CUT = 0.25  # difference of frames that do not show one scene, whatever moves
_LEAST_BEHIND_CUT = 3  # frames that must be like the first one behind a cut
_MOST_AHEAD = 8  # frames that are looked at before an unlike one is judged
_MOST_KINDS = 16


@dataclass(eq=False)
class Kind:
    """Frames that may be fused with each other.

    settings: of its first frame.
    gain: power of two that its grey values are multiplied by, so that they fill the scale.
    first, last: numbers of its frames in the sequence.  count: of them.
    """

    settings: RecordedSettings
    gain: float
    shape: tuple[int, ...]
    thumbnail: Array
    first: int
    last: int
    count: int = 0

    def add(self, look: _Look) -> None:
        """Count a frame to the kind."""
        self.thumbnail = look.thumbnail
        self.last = look.number
        self.count += 1


@dataclass(frozen=True, eq=False)
class _Look:
    """A frame that is being judged.  number: of the frame.  gain: see `Kind`."""

    number: int
    shot: SequenceFrame
    thumbnail: Array
    gain: float


@dataclass(eq=False)
class KindFinder:
    """Finds the kind of each frame of a sequence.

    looks_ahead: whether later frames may be waited for where a frame is unlike those before it.
    kinds: found so far.
    """

    looks_ahead: bool = True
    kinds: list[Kind] = field(default_factory=list)
    _waiting: deque[_Look] = field(default_factory=deque)
    _seen: int = 0
    _gain: float = 1.0

    def push(self, shot: SequenceFrame) -> Iterator[tuple[SequenceFrame, Kind]]:
        """Take the next frame; each frame that is judged by now with its kind, in order."""
        self._gain = gain_of(grey_of(shot.levels), self._gain)
        levels = shot.levels * np.float32(self._gain) if self._gain != 1 else shot.levels
        self._waiting.append(_Look(self._seen, shot, thumbnail_of(grey_of(levels)), self._gain))
        self._seen += 1
        yield from self._judged(is_end=False)

    def finish(self) -> Iterator[tuple[SequenceFrame, Kind]]:
        """The frames that are left; the sequence has ended."""
        yield from self._judged(is_end=True)

    def _judged(self, *, is_end: bool) -> Iterator[tuple[SequenceFrame, Kind]]:
        """The waiting frames that can be judged by now, each with its kind."""
        while self._waiting:
            look = self._waiting[0]
            kind = self._kind_of(look, is_end=is_end or not self.looks_ahead)
            if kind is None:
                return
            self._waiting.popleft()
            kind.add(look)
            yield look.shot, kind

    def _kind_of(self, look: _Look, *, is_end: bool) -> Kind | None:
        """The kind of the next frame; None where frames after it must be seen first."""
        candidates = [kind for kind in self.kinds if _is_stated_like(kind, look)]
        if not candidates:
            return self._new_kind(look)
        newest = max(candidates, key=lambda kind: kind.last)
        from_newest = difference(look.thumbnail, newest.thumbnail)
        is_alike = from_newest <= UNLIKE
        # The stream itself makes up for a gain that flickers or steps.
        if is_alike or likeness_of(look.thumbnail, newest.thumbnail).difference <= UNLIKE:
            return newest

        nearest = min(candidates, key=lambda kind: difference(look.thumbnail, kind.thumbnail))
        if difference(look.thumbnail, nearest.thumbnail) < _MUCH_CLOSER * from_newest:
            return nearest

        later = [later_look for later_look in self._waiting if later_look.number > look.number]
        later = [later_look for later_look in later if _is_stated_like(newest, later_look)]
        if any(_returns(later_look, look, newest) for later_look in later):
            return self._new_kind(look)
        if is_end or len(self._waiting) > _MOST_AHEAD:
            return self._new_kind(look) if _is_cut(look, later, newest) else newest
        return None

    def _new_kind(self, look: _Look) -> Kind:
        if len(self.kinds) >= _MOST_KINDS:
            # The one that was not seen for longest makes room.
            self.kinds.remove(min(self.kinds, key=lambda kind: kind.last))
        kind = Kind(
            look.shot.settings,
            look.gain,
            look.shot.levels.shape,
            look.thumbnail,
            first=look.number,
            last=look.number,
        )
        self.kinds.append(kind)
        return kind


def _is_stated_like(kind: Kind, look: _Look) -> bool:
    """Whether the settings of a frame, as far as they are stated, are those of a kind."""
    is_same_form = kind.shape == look.shot.levels.shape and kind.gain == look.gain
    return is_same_form and kind.settings.is_like(look.shot.settings)


def _is_cut(look: _Look, later: list[_Look], kind: Kind) -> bool:
    """Whether a frame and those after it show something else, such as pings behind a title.

    What was measured on one of both says nothing of the other.
    """
    alike = [
        later_look
        for later_look in later
        if difference(later_look.thumbnail, look.thumbnail) < _CUT
    ]
    return len(alike) >= _LEAST_BEHIND_CUT and all(
        difference(frame.thumbnail, kind.thumbnail) > _CUT for frame in (look, *alike)
    )


def _returns(later: _Look, look: _Look, kind: Kind) -> bool:
    """Whether a later frame is of the kind from which the judged one differs."""
    from_kind = difference(later.thumbnail, kind.thumbnail)
    from_judged = difference(later.thumbnail, look.thumbnail)
    judged_from_kind = difference(look.thumbnail, kind.thumbnail)
    return from_kind < _MUCH_CLOSER * min(from_judged, judged_from_kind)
