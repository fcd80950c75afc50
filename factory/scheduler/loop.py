"""The run loop: frames to render workers, shards to noise workers, results beside the shards.

Two queues and no barrier: a shard is made as soon as its own frames are prepared, and shards that
can be made go before frames that can be prepared.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from typing import Any

from ..dataset.manifest import Failure, FailureKind
from ..errors import FactoryError
from ..frame import FrameRef
from ..storage.publish import Publication
from .plan import Job, ShardTask
from .progress import ProgressBar
from .results import Results, Resumed
from .settings import NOISE, RENDER
from .worker import (
    AttemptState,
    FrameAttempt,
    FrameResult,
    ShardAttempt,
    ShardResult,
    make_shard,
    prepare_frame,
)
from .workers.contract import Backend

_POLL_S = 0.2
# So many workers that die without having begun a frame, one after another, are no accident.
_MAX_BARREN_DEATHS = 10


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


class _Shard(Pending):
    """A shard to make.

    needs: names of the frames that have to be prepared before.
    keys: of those that were, by their names; see `schema.Prepared`.
    """

    def __init__(self, task: ShardTask, retries: int) -> None:
        super().__init__([ref for ref, _ in task.items], retries, task.path)
        self.task = task
        self.needs: set[str] = set()
        self.keys: dict[str, str] = {}


class _Frame(Pending):
    """A frame to prepare, and the shards that wait for it."""

    def __init__(self, ref: FrameRef, retries: int) -> None:
        super().__init__([ref], retries)
        self.ref = ref
        self.waiting: list[_Shard] = []


class Loop:
    """Makes the shards that `resumed` leaves to do, and tries again when workers die."""

    def __init__(
        self,
        job: Job,
        resumed: Resumed,
        results: Results,
        progress: ProgressBar,
        backend: Backend,
        publication: Publication | None = None,
    ) -> None:
        self._job, self._scheduler = job, job.scheduler
        self._recipe = replace(job.recipe, publication=publication)
        # Who shares no folder shares no renders either, and makes those of its own shard.
        self._prepares = job.preparer is not None and not self._recipe.apart
        self._lacking = resumed.lacking
        self._results, self._progress = results, progress
        self._backend = backend
        self._ready: deque[_Shard] = deque()
        self._preparing: deque[_Frame] = deque()
        self._needed: dict[str, _Frame] = {}
        self._running: dict[Future[Any], tuple[_Shard | _Frame, AttemptState]] = {}
        self._unsettled = len(resumed.todo)
        self._failed_frames = 0
        self._barren_deaths = 0
        for task in resumed.todo:
            self._add(task)
        progress.frames_total = len(self._needed)

    def _add(self, task: ShardTask) -> None:
        shard = _Shard(task, self._scheduler.retries)
        if not self._prepares:
            self._ready.append(shard)
            return
        lacking = self._lacking.get(task.path)
        self._need(shard, [ref for ref, _ in task.items if lacking is None or ref.name in lacking])

    def run(self) -> None:
        """Go on until every shard is settled.

        Raises FactoryError for what no other try can mend, and what a worker raised.
        """
        while self._unsettled:
            self._submit_what_fits()
            done, _ = wait(self._running, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            if not self._running:
                time.sleep(_POLL_S)  # until a worker of the cluster comes back
            for future in done:
                self._take_result(*self._running.pop(future), future)
            self._backend.poll()
            shards = [state for work, state in self._running.values() if isinstance(work, _Shard)]
            self._progress.show(shards, self._failed_frames)

    def _submit_what_fits(self) -> None:
        limit_s = self._scheduler.frame_timeout_s
        while self._ready and self._backend.free(NOISE):
            shard, state = self._ready.popleft(), AttemptState()
            given_up, lacking = tuple(shard.given_up.values()), self._lacking.get(shard.path, ())
            attempt = ShardAttempt(shard.task, self._recipe, given_up, lacking, shard.keys)
            future = self._backend.submit(make_shard, attempt, limit_s, NOISE, state.hear)
            self._running[future] = shard, state
        while self._preparing and self._backend.free(RENDER):
            frame, state = self._preparing.popleft(), AttemptState()
            work = FrameAttempt(frame.ref, self._recipe)
            done = self._backend.submit(prepare_frame, work, limit_s, RENDER, state.hear)
            self._running[done] = frame, state

    def _take_result(self, work: _Shard | _Frame, state: AttemptState, future: Future[Any]) -> None:
        error = future.exception()
        if state.begun or error is None:
            self._barren_deaths = 0
        if error is not None:
            self._died(work, state, *self._cause(error))
        elif isinstance(work, _Frame):
            self._prepared(work, future.result())
        else:
            self._settle(work, future.result())

    def _cause(self, error: BaseException) -> tuple[FailureKind, str]:
        """Why a worker died; an error that is no death ends the run."""
        if isinstance(error, TimeoutError):
            limit_s = self._scheduler.frame_timeout_s
            return "timeout", f"took longer than scheduler.frame_timeout_s={limit_s:g}"
        reason = self._backend.why_died(error)
        if reason is None:
            raise error
        return "crash", reason

    def _died(
        self, work: _Shard | _Frame, state: AttemptState, kind: FailureKind, reason: str
    ) -> None:
        left = True
        if state.begun:
            left = work.died(0 if isinstance(work, _Frame) else state.in_hand, kind, reason)
        else:
            # Nothing of it was touched yet, so nothing of it is to blame.
            self._barren_deaths += 1
            if self._barren_deaths >= _MAX_BARREN_DEATHS:
                raise FactoryError(f"no worker lives long enough to begin a frame: {reason}")
        if isinstance(work, _Shard):
            self._ready.appendleft(work) if left else self._give_up(work)
        elif left:
            self._preparing.appendleft(work)
        else:
            self._prepared(work, FrameResult(work.given_up[work.ref.name]))

    def _need(self, shard: _Shard, refs: Sequence[FrameRef]) -> None:
        """Let the shard wait until these frames are prepared."""
        for ref in refs:
            if ref.name not in self._needed:
                self._needed[ref.name] = _Frame(ref, self._scheduler.retries)
                self._preparing.append(self._needed[ref.name])
            self._needed[ref.name].waiting.append(shard)
            shard.needs.add(ref.name)

    def _prepared(self, frame: _Frame, result: FrameResult) -> None:
        del self._needed[frame.ref.name]
        self._progress.prepared(result.hit, result.failure is not None)
        self._job.on_prepared(result.bytes)
        for shard in frame.waiting:
            if result.failure is not None:
                here = replace(result.failure, shard=shard.path)
                shard.given_up.setdefault(frame.ref.name, here)
            if result.key:
                shard.keys[frame.ref.name] = result.key
            shard.needs.discard(frame.ref.name)
            if not shard.needs:
                self._ready.append(shard)

    def _give_up(self, shard: _Shard) -> None:
        # A finished shard that was only asked for the frames it lacks is as good as before.
        lacking = self._lacking.get(shard.path)
        failures: tuple[Failure, ...] = tuple(shard.given_up.values())
        if lacking is not None:
            failures = tuple(one for one in failures if one.ref.name in lacking)
        self._settle(shard, ShardResult(None, failures, kept=lacking is not None))

    def _settle(self, shard: _Shard, result: ShardResult) -> None:
        self._unsettled -= 1
        self._failed_frames += len(result.failures)
        gone = {failure.ref.name for failure in result.failures}
        lost = sum(len(variants) for ref, variants in shard.task.items if ref.name in gone)
        self._progress.settled(shard.task.samples, lost)
        for size in result.renders:
            self._progress.frames_total += 1
            self._progress.prepared(False, False)
            self._job.on_prepared(size)
        self._results.settle(shard.task, result)
