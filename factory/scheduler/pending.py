"""Work that is not settled: how far it is, and what to do when its worker died."""

from __future__ import annotations

import re
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..dataset.write.failures import Failure, FailureKind
from ..frame import FrameRef

START, DONE, FAILED = "start", "done", "failed"
"""What a worker tells of a frame: it begins with number N, made N samples, or got none."""

# Before the first new try; each later one waits twice as long.
_BACKOFF_S, _MOST_BACKOFF_S = 0.2, 30.0
_PLACE = re.compile(r'File "[^"]*?([^/"]+)", line (\d+) in (\S+)')


@dataclass
class AttemptState:
    """What the run knows of one attempt.

    trace: file for the traceback of its worker.
    samples: made so far.  failed: frames that failed so far.
    in_hand: index of the frame being worked on, or None between frames.
    begun: whether any frame was begun.  heard_at: when something was told last (time.monotonic).
    """

    trace: Path
    samples: int = 0
    failed: int = 0
    in_hand: int | None = None
    begun: bool = False
    heard_at: float = field(default_factory=time.monotonic)

    def hear(self, message: tuple[str, int]) -> None:
        """Take in what the worker tells."""
        event, value = message
        self.heard_at = time.monotonic()
        if event == START:
            self.begun, self.in_hand = True, value
        else:
            self.in_hand = None
            self.samples += value if event == DONE else 0
            self.failed += event == FAILED

    def cause_of_death(self, limit_s: float) -> tuple[bool, str]:
        """Whether the worker was too late, and where it was (in brackets, if that is known).

        The file of its traceback is removed.
        """
        late = time.monotonic() - self.heard_at >= limit_s
        try:
            text = self.trace.read_text(encoding="utf-8", errors="replace")
            self.trace.unlink()
        except OSError:  # it was killed, or shares no folder with us
            return late, ""
        # Of the thread that was at work; the others only wait.
        parts = (part for part in text.split("\n\n") if "in answered" in part)
        found = _PLACE.search(next(parts, ""))
        place = f" ({found[3]}, {found[1]}:{found[2]})" if found else ""
        return late or "Timeout (" in text, place


class Pending:
    """A shard to make, or one frame to prepare, and what happened to it so far.

    A frame that was in hand at `retries` + 1 deaths is given up, and the rest goes on without it.
    Where workers die that often between frames, all are given up.  Every death uses up a try of one
    frame, so there is an end whatever happens.

    refs: its frames.  path: of the shard; empty for a frame.
    given_up: failures of frames that are not to be tried again, by their names.
    """

    def __init__(self, refs: Sequence[FrameRef], retries: int, path: str = "") -> None:
        self.path = path
        self.given_up: dict[str, Failure] = {}
        self.not_before = 0.0
        self.tries = 0
        self._refs, self._retries = refs, retries
        self._deaths: Counter[int | None] = Counter()

    def died(self, in_hand: int | None, kind: FailureKind, reason: str) -> bool:
        """Note a death with frame number `in_hand` in hand (None: between frames).

        Returns whether a frame is left to be tried again.
        """
        self._deaths[in_hand] += 1
        if (deaths := self._deaths[in_hand]) > self._retries:
            tries = f"in each of {deaths} tries" if deaths > 1 else "once tried"
            for ref in self._refs if in_hand is None else (self._refs[in_hand],):
                text = f"{ref.name}: {reason}, {tries}"
                self.given_up.setdefault(ref.name, Failure(ref, kind, text, self.path))
        return len(self.given_up) < len(self._refs)

    def wait(self, deaths: int = 0) -> None:
        """Set when it is tried again: ever later, up to half a minute.

        deaths: so many workers died, if it was not over this.
        """
        deaths = deaths or self._deaths.total()
        pause_s = min(_BACKOFF_S * 2.0 ** max(0, deaths - 1), _MOST_BACKOFF_S)
        self.not_before = time.monotonic() + pause_s
