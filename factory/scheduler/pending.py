"""What to do about work whose worker died: try again, or give up the frame that kills it."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from ..dataset.write.failures import Failure, FailureKind
from ..frame import FrameRef
from .plan import ShardTask


class PendingShard:
    """A shard that is not settled yet, and what happened to it so far.

    A frame that was in hand at `retries` + 1 deaths is given up, and the shard goes on without
    it.  A shard whose workers die that often between frames is given up as a whole.  Every death
    uses up a try of one frame, so there is an end whatever happens.

    needs: names of the frames that have to be prepared before the shard can be made.
    keys: of those that were, by their names; see `sample.Prepared`.
    rounds: how often it was found that a prepared frame was gone again.
    begun: when a worker was last given it (time.monotonic).
    """

    def __init__(self, task: ShardTask, retries: int) -> None:
        self.task = task
        self.number = 0
        self.not_before = self.begun = 0.0
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
        text = f"{reason}, {tries_text(self._deaths[in_hand])}"
        culprits = self.task.items if in_hand is None else (self.task.items[in_hand],)
        for ref, _ in culprits:
            failure = Failure(ref, kind, f"{ref.name}: {text}", self.task.path)
            self._given_up.setdefault(ref.name, failure)
        return in_hand is not None


class PendingFrame:
    """A frame that is to be prepared, and what happened to it so far.

    waiting: the shards that need it.  begun: when a worker was last given it (time.monotonic).
    """

    def __init__(self, ref: FrameRef, retries: int) -> None:
        self.ref = ref
        self.number = 0
        self.not_before = self.begun = 0.0
        self.deaths = 0
        self.waiting: list[PendingShard] = []
        self._retries = retries

    def died(self, kind: FailureKind, reason: str) -> Failure | None:
        """Note a death over this frame; its failure when it is not to be tried again."""
        self.deaths += 1
        if self.deaths <= self._retries:
            return None
        text = f"{self.ref.name}: {reason}, {tries_text(self.deaths)}"
        return Failure(self.ref, kind, text, "")


def tries_text(deaths: int) -> str:
    """How often it was tried, for the end of a reason."""
    return f"in each of {deaths} tries" if deaths > 1 else "once tried"


def backoff_s(first_s: float, deaths: int) -> float:
    """Wait before the try after that many deaths: doubles, up to half a minute."""
    return float(min(first_s * 2.0 ** max(0, deaths - 1), 30.0))
