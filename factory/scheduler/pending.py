"""Work that is not settled: how far it is, and what to do when its worker died."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from ..dataset.manifest import Failure, FailureKind
from ..frame import FrameRef

START, DONE, FAILED = "start", "done", "failed"
"""What a worker tells of a frame: it begins with number N, made N samples, or got none."""


@dataclass
class AttemptState:
    """What the run knows of one attempt.

    samples: made so far.  failed: frames that failed so far.
    in_hand: index of the frame being worked on, or None between frames.
    begun: whether any frame was begun.
    """

    samples: int = 0
    failed: int = 0
    in_hand: int | None = None
    begun: bool = False

    def hear(self, message: tuple[str, int]) -> None:
        """Take in what the worker tells."""
        event, value = message
        if event == START:
            self.begun, self.in_hand = True, value
        else:
            self.in_hand = None
            self.samples += value if event == DONE else 0
            self.failed += event == FAILED


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
