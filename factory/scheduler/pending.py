"""Work that is not settled: how far it is, and what to do when its worker died."""

from __future__ import annotations

import re
import time
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..dataset.write.failures import Failure, FailureKind
from ..frame import FrameRef
from .plan import ShardTask

START, DONE, FAILED = "start", "done", "failed"
"""What a worker tells of a frame: it begins with number N, made N samples, or got none."""

_PLACE = re.compile(r'File "[^"]*?([^/"]+)", line (\d+) in (\S+)')


@dataclass
class AttemptState:
    """What the run knows of one attempt.

    samples: made so far.  failed: frames that failed so far.
    in_hand: index of the frame being worked on, or None between frames.
    begun: whether any frame was begun.  heard_at: when something was told last (time.monotonic).
    """

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

    def silent_s(self) -> float:
        """Seconds since something was told."""
        return time.monotonic() - self.heard_at


class PendingShard:
    """A shard that is not settled yet, and what happened to it so far.

    A frame that was in hand at `retries` + 1 deaths is given up, and the shard goes on without
    it.  A shard whose workers die that often between frames is given up as a whole.  Every death
    uses up a try of one frame, so there is an end whatever happens.

    needs: names of the frames that have to be prepared before the shard can be made.
    keys: of those that were, by their names; see `schema.Prepared`.
    rounds: how often it was found that a prepared frame was gone again.
    """

    def __init__(self, task: ShardTask, retries: int) -> None:
        self.task = task
        self.number = 0
        self.not_before = 0.0
        self.needs: set[str] = set()
        self.keys: dict[str, str] = {}
        self.rounds = 0
        self._retries = retries
        self._deaths: Counter[int | None] = Counter()
        self._given_up: dict[str, Failure] = {}

    @property
    def given_up(self) -> tuple[Failure, ...]:
        """Failures of the frames that are not to be tried again."""
        return tuple(self._given_up.values())

    @property
    def deaths(self) -> int:
        """Workers that died over this shard."""
        return self._deaths.total()

    def give_up(self, failure: Failure) -> None:
        """Go on without a frame that could not be prepared."""
        here = replace(failure, shard=self.task.path)
        self._given_up.setdefault(failure.ref.name, here)

    def died(self, in_hand: int | None, kind: FailureKind, reason: str) -> bool:
        """Note a death with frame number `in_hand` in hand (None: between frames).

        Returns whether the shard is to be tried again; if not, all its frames are in `given_up`.
        """
        self._deaths[in_hand] += 1
        if self._deaths[in_hand] <= self._retries:
            return True
        text = f"{reason}, {_tries(self._deaths[in_hand])}"
        culprits = self.task.items if in_hand is None else (self.task.items[in_hand],)
        for ref, _ in culprits:
            self.give_up(Failure(ref, kind, f"{ref.name}: {text}", self.task.path))
        return in_hand is not None


class PendingFrame:
    """A frame that is to be prepared, and what happened to it so far.

    waiting: the shards that need it.
    """

    def __init__(self, ref: FrameRef, retries: int) -> None:
        self.ref = ref
        self.number = 0
        self.not_before = 0.0
        self.deaths = 0
        self.waiting: list[PendingShard] = []
        self._retries = retries

    def died(self, kind: FailureKind, reason: str) -> Failure | None:
        """Note a death over this frame; its failure when it is not to be tried again."""
        self.deaths += 1
        if self.deaths <= self._retries:
            return None
        text = f"{self.ref.name}: {reason}, {_tries(self.deaths)}"
        return Failure(self.ref, kind, text, "")


def _tries(deaths: int) -> str:
    return f"in each of {deaths} tries" if deaths > 1 else "once tried"


def backoff_s(first_s: float, deaths: int) -> float:
    """Wait before the try after that many deaths: doubles, up to half a minute."""
    return float(min(first_s * 2.0 ** max(0, deaths - 1), 30.0))


def told_by(trace: Path) -> tuple[bool, str]:
    """What the traceback of a dead worker tells: it was too late; where it was, in brackets.

    Both are empty for a worker that was killed.  The file is removed.
    """
    try:
        text = trace.read_text(encoding="utf-8", errors="replace")
        trace.unlink()
    except OSError:
        return False, ""
    # Of the thread that was at work; the others only wait.
    parts = (part for part in text.split("\n\n") if "in _call_pickled" in part)
    found = _PLACE.search(next(parts, ""))
    return "Timeout (" in text, f" ({found[3]}, {found[1]}:{found[2]})" if found else ""
