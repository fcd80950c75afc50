"""What to do about a shard whose worker died: try again, or give up the frame that kills it."""

from __future__ import annotations

from collections import Counter

from factory.scheduler.plan import ShardTask
from factory.shards.failures import Failure, FailureKind


class Attempts:
    """The record of one shard.

    A frame that was in hand at `retries` + 1 deaths is given up, and the shard goes on without
    it.  A shard whose workers die that often between frames is given up as a whole.  Every death
    uses up a try of one frame, so there is an end whatever happens.
    """

    def __init__(self, task: ShardTask, retries: int) -> None:
        self.task = task
        self.number = 0
        self._retries = retries
        self._deaths: Counter[int | None] = Counter()
        self._given_up: dict[str, Failure] = {}

    @property
    def given_up(self) -> tuple[Failure, ...]:
        """Failures of the frames that are not to be tried again."""
        return tuple(self._given_up.values())

    def died(self, in_hand: int | None, kind: FailureKind, reason: str) -> bool:
        """Note a death with frame number `in_hand` in hand (None: between frames).

        Returns whether the shard is to be tried again; if not, all its frames are in `given_up`.
        """
        self._deaths[in_hand] += 1
        if self._deaths[in_hand] <= self._retries:
            return True
        tries = f"in each of {self._deaths[in_hand]} tries" if self._retries else "once tried"
        text = f"{reason}, {tries}"
        culprits = self.task.items if in_hand is None else (self.task.items[in_hand],)
        for ref, _ in culprits:
            failure = Failure(ref, kind, f"{ref.name}: {text}", self.task.path)
            self._given_up.setdefault(ref.name, failure)
        return in_hand is not None
