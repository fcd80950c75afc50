"""The run loop: frames to render workers, shards to noise workers, results beside the shards.

Two queues and no barrier: a shard is made as soon as its own frames are prepared, and shards that
can be made go before frames that can be prepared.
"""

from __future__ import annotations

import pickle
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..dataset.write.failures import FailureKind
from ..errors import FactoryError
from ..frame import FrameRef
from ..storage.publish import Publication
from .job import Job
from .lock import Lock
from .pending import AttemptState, PendingFrame, PendingShard, backoff_s, told_by
from .plan import ShardTask
from .progress import ProgressBar
from .results import Results, Resumed
from .settings import NOISE, RENDER
from .worker import (
    FrameAttempt,
    FrameResult,
    ShardAttempt,
    ShardResult,
    run_frame,
    run_shard,
)
from .workers.contract import Backend

_POLL_S = 0.2
# Longer than the limit of a frame that a worker may be silent.
_GRACE_S = 5.0
# So many workers that die without having begun a frame, one after another, are no accident.
_MAX_BARREN_DEATHS = 10
# A shard whose frames vanish from the cache that often will not be made.
_MAX_ROUNDS = 20

Pending = PendingShard | PendingFrame


class Loop:
    """Makes the shards that `resumed` leaves to do, and tries again when workers die."""

    def __init__(
        self,
        job: Job,
        resumed: Resumed,
        results: Results,
        progress: ProgressBar,
        lock: Lock,
        backend: Backend,
        publication: Publication | None = None,
    ) -> None:
        self._job, self._scheduler = job, job.scheduler
        self._recipe = replace(job.recipe, fence=lock.fence, publication=publication)
        # Who shares no folder shares no renders either, and makes those of its own shard.
        self._prepares = job.preparer is not None and not self._recipe.apart
        self._lacking = resumed.lacking
        self._results, self._progress = results, progress
        self._backend = backend
        self._ready: deque[PendingShard] = deque()
        self._preparing: deque[PendingFrame] = deque()
        self._needed: dict[str, PendingFrame] = {}
        self._running: dict[Future[Any], tuple[Pending, AttemptState, Path]] = {}
        self._unsettled = len(resumed.todo)
        self._failed_frames = 0
        self._barren_deaths = 0
        for task in resumed.todo:
            self._add(task)
        progress.frames_total = len(self._needed)

    def _add(self, task: ShardTask) -> None:
        shard = PendingShard(task, self._scheduler.retries)
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
                time.sleep(0.01)  # all that is left waits for its next try
            for future in done:
                self._take_result(*self._running.pop(future), future)
            self._backend.poll()
            self._progress.show(
                [
                    state
                    for work, state, _ in self._running.values()
                    if isinstance(work, PendingShard)
                ],
                self._failed_frames,
            )

    def _submit_what_fits(self) -> None:
        now = time.monotonic()
        while self._backend.free(NOISE) and (shard := _take(self._ready, now)):
            self._submit_shard(shard)
        while self._backend.free(RENDER) and (frame := _take(self._preparing, now)):
            self._submit_frame(frame)

    def _submit_shard(self, shard: PendingShard) -> None:
        trace = self._trace(shard.task.path, shard)
        lacking = self._lacking.get(shard.task.path, ())
        attempt = ShardAttempt(shard.task, self._recipe, trace, shard.given_up, lacking, shard.keys)
        self._submit(run_shard, attempt, NOISE, shard, trace)

    def _submit_frame(self, frame: PendingFrame) -> None:
        trace = self._trace(frame.ref.name, frame)
        attempt = FrameAttempt(frame.ref, self._recipe, trace)
        self._submit(run_frame, attempt, RENDER, frame, trace)

    def _submit(
        self,
        function: Callable[[bytes], Any],
        attempt: ShardAttempt | FrameAttempt,
        pool: str,
        work: Pending,
        trace: Path,
    ) -> None:
        state = AttemptState()
        # A worker ends itself when a frame takes too long, which leaves its traceback; one that
        # was stopped cannot, and is killed a little later.
        silence_s = self._scheduler.frame_timeout_s + _GRACE_S
        pickled = pickle.dumps(attempt)
        future = self._backend.submit(function, pickled, silence_s, pool, state.hear)
        self._running[future] = (work, state, trace)

    def _trace(self, name: str, work: Pending) -> Path:
        work.number += 1
        return self._recipe.work_folder / f"{name.replace('/', '-')}.{work.number}.trace"

    def _take_result(
        self, work: Pending, state: AttemptState, trace: Path, future: Future[Any]
    ) -> None:
        error = future.exception()
        late, place = told_by(trace)
        if state.begun or error is None:
            self._barren_deaths = 0
        if error is None:
            result = future.result()
            if isinstance(work, PendingFrame):
                self._prepared(work, result)
            elif result.missing:
                self._need_again(work, result.missing)
            else:
                self._settle(work, result)
            return
        late = late or state.silent_s() >= self._scheduler.frame_timeout_s
        kind, reason = self._cause(error, late)
        reason += place
        if not state.begun:
            # Nothing of it was touched yet, so nothing of it is to blame.
            self._barren_deaths += 1
            if self._barren_deaths >= _MAX_BARREN_DEATHS:
                raise FactoryError(f"no worker lives long enough to begin a frame: {reason}")
            again = True
        elif isinstance(work, PendingFrame):
            failure = work.died(kind, reason)
            again = failure is None
            if failure is not None:
                self._prepared(work, FrameResult(failure))
        else:
            again = work.died(state.in_hand, kind, reason)
            if not again:
                self._give_up(work)
        if again:
            self._retry_later(work, work.deaths if state.begun else self._barren_deaths)

    def _retry_later(self, work: Pending, deaths: int) -> None:
        work.not_before = time.monotonic() + backoff_s(self._scheduler.backoff_s, deaths)
        if isinstance(work, PendingFrame):
            self._preparing.appendleft(work)
        else:
            self._ready.appendleft(work)

    def _cause(self, error: BaseException, timed_out: bool) -> tuple[FailureKind, str]:
        """Why a worker died; an error that is no death ends the run."""
        reason = self._backend.why_died(error)
        if isinstance(error, TimeoutError) or (reason and timed_out):
            limit_s = self._scheduler.frame_timeout_s
            return "timeout", f"took longer than scheduler.frame_timeout_s={limit_s:g}"
        if reason is None:
            raise error
        return "crash", reason

    def _need(self, shard: PendingShard, refs: Sequence[FrameRef]) -> None:
        """Let the shard wait until these frames are prepared."""
        for ref in refs:
            if ref.name not in self._needed:
                self._needed[ref.name] = PendingFrame(ref, self._scheduler.retries)
                self._preparing.append(self._needed[ref.name])
            self._needed[ref.name].waiting.append(shard)
            shard.needs.add(ref.name)

    def _need_again(self, shard: PendingShard, missing: Sequence[FrameRef]) -> None:
        shard.rounds += 1
        if shard.rounds > _MAX_ROUNDS or self._recipe.preparer is None:
            raise FactoryError(
                f"{missing[0].name}: its render vanishes from the cache before it is used; "
                "raise cache.max_bytes, it must hold the frames of a shard for every worker"
            )
        self._need(shard, missing)
        self._progress.frames_total += len(missing)

    def _prepared(self, frame: PendingFrame, result: FrameResult) -> None:
        del self._needed[frame.ref.name]
        self._progress.prepared(result.hit, result.failure is not None)
        self._job.on_prepared(result.bytes)
        for shard in frame.waiting:
            if result.failure is not None:
                shard.give_up(result.failure)
            if result.key:
                shard.keys[frame.ref.name] = result.key
            shard.needs.discard(frame.ref.name)
            if not shard.needs:
                self._ready.append(shard)

    def _give_up(self, shard: PendingShard) -> None:
        # A finished shard that was only asked for the frames it lacks is as good as before.
        lacking = self._lacking.get(shard.task.path)
        failures = tuple(
            failure for failure in shard.given_up if lacking is None or failure.ref.name in lacking
        )
        self._settle(shard, ShardResult(None, failures, kept=lacking is not None))

    def _settle(self, shard: PendingShard, result: ShardResult) -> None:
        self._unsettled -= 1
        self._failed_frames += len(result.failures)
        self._progress.settled_samples += shard.task.samples
        gone = {failure.ref.name for failure in result.failures}
        self._progress.lost_samples += sum(
            len(variants) for ref, variants in shard.task.items if ref.name in gone
        )
        self._results.settle(shard.task, result)


def _take(queue: deque[Any], now: float) -> Any:
    """The first of the queue whose time has come, or None."""
    for index, work in enumerate(queue):
        if work.not_before <= now:
            del queue[index]
            return work
    return None
