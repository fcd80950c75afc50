"""Sequences of several kinds of frames: each kind goes through a stream of its own."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ....factory.common.array_types import Array
from .kinds import Kind, KindFinder
from .repeated import Unrepeated
from .stream import InTime, SequenceFrame
from .strength import Strength

_PAUSE = 32
"""Frames of other kinds after which a stream no longer waits for the next one of its own."""
_MOST_NAMED = 6
_MOST_REMEMBERED = 64  # kinds: a live stream has no end


@dataclass(frozen=True, eq=False)
class _Ticket:
    """The key of a frame on its way through a stream.

    place: in the sequence.  levels: as they were before they were multiplied by `gain`.
    """

    place: int
    key: Any
    levels: Array
    gain: float

    def restored(self, denoised: Array) -> Array:
        """What became of the levels, without the gain; what is brighter than its scale stays."""
        if self.gain == 1:
            return denoised
        gain = np.float32(self.gain)
        return np.where(self.levels * gain > 1, self.levels, denoised / gain)


@dataclass(eq=False)
class _KindStream:
    """The stream of a kind.

    in_time: denoises.  frames: the same behind what leaves out copies.  is_resting: whether all of
    its frames were taken from it.
    """

    in_time: InTime
    frames: Unrepeated
    is_resting: bool = False


class Interleaved:
    """Denoises a sequence, each kind of frame in a stream of its own; results come in order.

    new_stream: makes the stream of a kind, given its `tally`.  tally: see `InTime`.
    looks_ahead: see `KindFinder`.
    """

    def __init__(
        self, new_stream: Callable[..., InTime], tally: dict[str, float], *, looks_ahead: bool
    ) -> None:
        self._new_stream = new_stream
        self._spare: InTime | None = new_stream(tally=tally)  # for the first kind
        self._tally = tally
        self._finder = KindFinder(looks_ahead)
        self._streams: dict[Kind, _KindStream] = {}
        self._place = 0
        self._finished: dict[int, tuple[Any, Array]] = {}
        self._order: deque[int] = deque()  # places of the frames whose results are to come
        self._kinds: list[Kind] = []  # the first ones
        self._kind_count = 0
        self._ended: Strength | None = None  # of the kind that it was fitted to most often

    def push(self, shot: SequenceFrame) -> Iterator[tuple[Any, Array]]:
        """Take the next frame; the key of each that is denoised by now and its levels, in order."""
        self._pass_on(self._finder.push(shot))
        yield from self._in_order()

    def finish(self) -> Iterator[tuple[Any, Array]]:
        """Yield all frames that are left; the sequence has ended."""
        self._pass_on(self._finder.finish())
        for kind in list(self._streams):
            self._end(kind)
        yield from self._in_order()

    def close(self) -> None:
        """End the threads of a sequence that is not finished."""
        for stream in self._in_time():
            stream.close()

    @property
    def strength(self) -> Strength:
        """The strength of the kind that it was fitted to most often."""
        strengths = [stream.strength for stream in self._in_time()]
        if self._ended is not None:
            strengths.append(self._ended)
        return max(strengths, key=lambda strength: strength.measured)

    def _in_time(self) -> list[InTime]:
        streams = [stream.in_time for stream in self._streams.values()]
        return streams if self._spare is None else [self._spare, *streams]

    def summary(self) -> Iterator[str]:
        """What was found in the sequence, line by line."""
        if len(self._kinds) > 1:
            named = ", ".join(self._named(kind) for kind in self._kinds[:_MOST_NAMED])
            more = self._kind_count - _MOST_NAMED
            named += f" and {more} more" if more > 0 else ""
            yield (
                f"kinds of frames: {self._kind_count}, each denoised among its like: {named}; "
                "if that is wrong, --frames 1 denoises each frame alone"
            )

    def _named(self, kind: Kind) -> str:
        """A kind by what tells it from the others, with its frames."""
        texts = [
            text
            for other_kind in self._kinds
            if other_kind is not kind
            for text in kind.settings.differences(other_kind.settings)
        ]
        name = ", ".join(dict.fromkeys(texts)) or f"like frame {kind.first}"
        plural = "s" * (kind.count != 1)
        return f"{name} ({kind.count} frame{plural}, {kind.first} to {kind.last})"

    def _pass_on(self, judged: Iterable[tuple[SequenceFrame, Kind]]) -> None:
        """Give frames to the streams of their kinds."""
        for shot, kind in judged:
            if shot.wanted:
                self._order.append(self._place)
            stream = self._streams.get(kind)
            if stream is None:
                in_time = self._next_stream()
                stream = _KindStream(in_time, Unrepeated(in_time, self._tally))
                self._streams[kind] = stream
                self._kind_count += 1
                if self._kind_count <= _MOST_REMEMBERED:
                    self._kinds.append(kind)
            stream.is_resting = False
            self._keep(stream.frames.push(_ticketed(shot, self._place, kind)))
            self._let_rest()
            self._place += 1

    def _next_stream(self) -> InTime:
        if self._spare is not None:
            stream = self._spare
            self._spare = None
            return stream
        return self._new_stream(tally=self._tally)

    def _let_rest(self) -> None:
        """Take what is left from streams whose kind has not been seen for long."""
        if len(self._streams) < 2:
            return
        for kind, stream in list(self._streams.items()):
            if kind not in self._finder.kinds:
                self._end(kind)
            elif self._place - kind.last > _PAUSE and not stream.is_resting:
                self._keep(stream.frames.flush())
                stream.is_resting = True

    def _end(self, kind: Kind) -> None:
        stream = self._streams.pop(kind)
        self._keep(stream.frames.finish())
        kind.thumbnail = np.zeros((0, 0), np.float32)
        strength = stream.in_time.strength
        if self._ended is None or strength.measured > self._ended.measured:
            self._ended = strength

    def _keep(self, results: Iterable[tuple[Any, Array]]) -> None:
        for ticket, denoised in results:
            self._finished[ticket.place] = ticket.key, ticket.restored(denoised)

    def _in_order(self) -> Iterator[tuple[Any, Array]]:
        while self._order and self._order[0] in self._finished:
            yield self._finished.pop(self._order.popleft())


def _ticketed(shot: SequenceFrame, place: int, kind: Kind) -> SequenceFrame:
    """A shot as the stream of its kind takes it."""
    ticket = _Ticket(place, shot.key, shot.levels, kind.gain)
    levels = shot.levels
    if kind.gain != 1:
        levels = np.minimum(levels * np.float32(kind.gain), np.float32(1))
    return replace(shot, key=ticket, levels=levels)
