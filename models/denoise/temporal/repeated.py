"""Copies of a frame in a sequence: they are left out of the windows, and get its result."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np

from ....factory.common.array_types import Array
from ...recordings.repeats import RepeatFinder
from .motion import grey_of
from .stream import InTime, SequenceFrame, outside_of

_MOST_COPIES = 64
"""Copies that wait for one result; after this many the next one counts as a frame of its own."""
_CHANGED = 0.1  # grey value: a codec changes a copy by less, a clock over the fan by more
_WINDOW_PX = 3


@dataclass(eq=False)
class _Run:
    """A frame and those of its copies that are wanted.

    levels of a copy: None where it is exact.  count: of all copies.
    """

    shot: SequenceFrame
    copies: deque[tuple[Any, Array | None]] = field(default_factory=deque)
    count: int = 0


class Unrepeated:
    """Passes every frame but copies through a stream.

    tally: `repeats` counts the copies.
    """

    def __init__(self, stream: InTime, tally: dict[str, float]) -> None:
        self._stream = stream
        self._tally = tally
        self._finder = RepeatFinder()
        self._runs: deque[_Run] = deque()  # whose results are to come
        self._newest: _Run | None = None
        self._waits = False  # whether the newest frame waits for a copy that is wanted
        self._last: tuple[_Run, Array] | None = None  # the last result

    def __call__(self, shots: Iterable[SequenceFrame]) -> Iterator[tuple[Any, Array]]:
        """The key of each frame that is wanted and its levels, denoised, in order."""
        for shot in shots:
            yield from self.push(shot)
        yield from self.finish()

    def push(self, shot: SequenceFrame) -> Iterator[tuple[Any, Array]]:
        """Take the next frame; yields those that are denoised by now, a copy at once."""
        is_repeat = self._finder.is_repeat(grey_of(shot.levels))
        newest = self._newest
        if is_repeat and newest is not None and newest.count < _MOST_COPIES:
            self._add_copy(newest, shot)
            if self._last is not None and self._last[0] is newest:
                yield from self._copies(*self._last)
            return
        yield from self._pass_waiting()
        self._newest = _Run(shot)
        # A copy of an unwanted frame may be wanted.
        self._waits = not shot.wanted
        if not self._waits:
            yield from self._pass_on(self._newest)

    def flush(self) -> Iterator[tuple[Any, Array]]:
        """See `InTime.flush`."""
        yield from self._pass_waiting()
        yield from self._results(self._stream.flush())

    def finish(self) -> Iterator[tuple[Any, Array]]:
        """See `InTime.finish`."""
        yield from self._pass_waiting()
        yield from self._results(self._stream.finish())

    def close(self) -> None:
        """See `InTime.close`."""
        self._stream.close()

    def _pass_waiting(self) -> Iterator[tuple[Any, Array]]:
        if self._newest is not None and self._waits:
            self._waits = False
            yield from self._pass_on(self._newest)

    def _pass_on(self, run: _Run) -> Iterator[tuple[Any, Array]]:
        """Give the frame of a run to the stream, wanted where a copy is."""
        wanted = run.shot.wanted or bool(run.copies)
        if wanted:
            self._runs.append(run)
        yield from self._results(self._stream.push(replace(run.shot, wanted=wanted)))

    def _results(self, denoised: Iterable[tuple[Any, Array]]) -> Iterator[tuple[Any, Array]]:
        """Each result of the stream, where its frame is wanted, and those of its copies."""
        for key, levels in denoised:
            run = self._runs.popleft()
            self._last = run, levels
            if run.shot.wanted:
                yield key, levels
            yield from self._copies(run, levels)

    def _add_copy(self, run: _Run, shot: SequenceFrame) -> None:
        run.count += 1
        self._tally["repeats"] += 1
        if shot.wanted:
            is_exact = np.array_equal(shot.levels, run.shot.levels)
            run.copies.append((shot.key, None if is_exact else shot.levels))

    def _copies(self, run: _Run, denoised: Array) -> Iterator[tuple[Any, Array]]:
        while run.copies:
            key, levels = run.copies.popleft()
            yield key, denoised if levels is None else _of_copy(run.shot, denoised, levels)


def _of_copy(shot: SequenceFrame, denoised: Array, levels: Array) -> Array:
    """What was made of a frame, with what its copy shows besides: a clock, pixels around the fan.

    shot: the frame.  levels: of the copy.
    """
    if levels.shape != denoised.shape:
        return denoised
    apart = cv2.blur(np.abs(grey_of(levels) - grey_of(shot.levels)), (_WINDOW_PX, _WINDOW_PX))
    wide = np.ones((_WINDOW_PX, _WINDOW_PX), np.uint8)
    own = cv2.dilate((apart > _CHANGED).astype(np.uint8), wide) > 0
    geometry = shot.place()
    if geometry is not None and geometry.layout != "polar":
        own = own | outside_of(geometry, *own.shape)
    result = denoised.copy()
    result[own] = levels[own]
    return result
