"""The run loop: frames to render workers, shards to noise workers, results beside the shards.

Two queues and no barrier: a shard is made as soon as its own frames are prepared, and shards that
can be made go before frames that can be prepared.
"""

from __future__ import annotations

import time
from collections import Counter, deque
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from typing import Any

from ...common.errors import FactoryError
from ...common.workers import Backend, Task, WorkerDied
from ...common.workers.settings import NOISE, RENDER
from ...dataset.frame_ref import FrameRef
from ...dataset.manifest import Failure, FailureKind
from ...dataset.schema import Prepared
from .plan import DatasetJob
from .progress import ProgressBar
from .results import Results
from .worker import ShardAttempt, ShardResult, make_shard, prepare_frame

_POLL_S = 0.2
# So many workers that die without having begun a frame, one after another, are no accident.
_MAX_BARREN_DEATHS = 10


# A shard to make, or a frame to prepare.
_Work = ShardAttempt | FrameRef
# What a worker told of its attempt last, if anything: see `make_shard`.
_Reports = deque[tuple[int | None, int, int]]


class ShardLoop:
    """Makes the shards that `results` leaves to do, and tries again when workers die.

    A frame that was in hand at `retries` + 1 deaths is given up, and the rest goes on without it.
    Where workers die that often between frames, all are given up.  Every death uses up a try of one
    frame, so there is an end whatever happens.
    """

    def __init__(
        self, job: DatasetJob, results: Results, progress: ProgressBar, backend: Backend
    ) -> None:
        self._job = job
        self._recipe = job.recipe
        self._results = results
        self._progress = progress
        self._backend = backend
        self._ready: deque[ShardAttempt] = deque()
        self._running: dict[Future[Any], tuple[_Work, _Reports]] = {}
        self._deaths: Counter[tuple[_Work, int | None]] = Counter()
        self._barren_deaths = 0
        self._unsettled = len(results.todo)
        # Number of frames that a shard waits for.
        self._needs: Counter[ShardAttempt] = Counter()
        self._waiting: dict[FrameRef, list[ShardAttempt]] = {}
        for task in results.todo:
            shard = ShardAttempt(task, self._recipe, results.lacking.get(task.path, ()))
            for ref, _ in task.items if job.prepares else ():
                if not shard.lacking or ref.name in shard.lacking:
                    self._waiting.setdefault(ref, []).append(shard)
                    self._needs[shard] += 1
            if not self._needs[shard]:
                self._ready.append(shard)
        self._preparing = deque(self._waiting)
        progress.frames["total"] = len(self._waiting)

    def run(self) -> None:
        """Go on until every shard is settled.

        Raises FactoryError for an error that no other attempt can repair, and what a worker raised.
        """
        while self._unsettled:
            self._submit_what_fits()
            done, _ = wait(self._running, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            if not self._running:
                time.sleep(_POLL_S)  # until a worker of the cluster comes back
            for future in done:
                self._take_result(*self._running.pop(future), future)
            reports = [
                last for work, last in self._running.values() if isinstance(work, ShardAttempt)
            ]
            self._progress.show([last[-1] for last in reports if last])

    def _submit_what_fits(self) -> None:
        limit_s = self._job.scheduler.frame_timeout_s
        while self._ready and self._free(NOISE):
            shard = self._ready.popleft()
            reports = _Reports(maxlen=1)
            task = Task(make_shard, shard, NOISE, limit_s, reports.append)
            self._running[self._backend.submit(task)] = shard, reports
        while self._preparing and self._free(RENDER):
            ref = self._preparing.popleft()
            reports = _Reports(maxlen=1)
            task = Task(prepare_frame, (ref, self._recipe), RENDER, limit_s, reports.append)
            self._running[self._backend.submit(task)] = ref, reports

    def _free(self, kind: str) -> bool:
        # Each result is on record before more begins: in this process all would be done first.
        return self._backend.free(kind) and not any(map(Future.done, self._running))

    def _take_result(self, work: _Work, reports: _Reports, future: Future[Any]) -> None:
        error = future.exception()
        if reports or error is None:
            self._barren_deaths = 0
        if isinstance(error, TimeoutError | WorkerDied):
            self._died(work, reports, error)
        elif error is not None:
            raise error
        elif isinstance(work, FrameRef):
            self._prepared(work, future.result())
        else:
            self._settle(work, future.result())

    def _died(self, work: _Work, reports: _Reports, error: TimeoutError | WorkerDied) -> None:
        """Account for a worker that died or was killed with some work in hand.

        The frame that it had begun is to blame: after `scheduler.retries` it is given up, and the
        rest of the work goes back to the front of the queue.  A death before any frame has no
        frame to blame.
        """
        kind: FailureKind = "crash"
        reason = str(error)
        if isinstance(error, TimeoutError):
            limit_s = self._job.scheduler.frame_timeout_s
            kind = "timeout"
            reason = f"took longer than scheduler.frame_timeout_s={limit_s:g}"
        if isinstance(work, FrameRef):
            refs = [work]
            path = ""
        else:
            refs = [ref for ref, _ in work.task.items]
            path = work.task.path
        failures: dict[str, Failure] = {}
        if reports:
            in_hand = reports[-1][0]
            self._deaths[work, in_hand] += 1
            if (deaths := self._deaths[work, in_hand]) > self._job.scheduler.retries:
                tries = f"in each of {deaths} tries" if deaths > 1 else "once tried"
                for ref in refs if in_hand is None else (refs[in_hand],):
                    text = f"{ref.name}: {reason}, {tries}"
                    failures[ref.name] = Failure(ref, kind, text, path)
        else:
            # Nothing of it was touched yet, so nothing of it is to blame.
            self._barren_deaths += 1
            if self._barren_deaths >= _MAX_BARREN_DEATHS:
                raise FactoryError(f"no worker lives long enough to begin a frame: {reason}")
        if isinstance(work, ShardAttempt):
            work.given_up = {**failures, **work.given_up}
            if len(work.given_up) < len(refs):
                self._ready.appendleft(work)
                return
            # A finished shard that was only asked for the frames it lacks is as good as before.
            requested = work.lacking or work.given_up
            lost = tuple(failure for name, failure in work.given_up.items() if name in requested)
            self._settle(work, ShardResult(None, lost, keeps_file=bool(work.lacking)))
        elif failures:
            self._prepared(work, failures[work.name])
        else:
            self._preparing.appendleft(work)

    def _prepared(self, ref: FrameRef, result: Prepared | Failure) -> None:
        if isinstance(result, Failure):
            self._progress.frames["failed"] += 1
        else:
            self._progress.frames["from_cache" if result.hit else "rendered"] += 1
            self._job.on_prepared(result.bytes)
        for shard in self._waiting[ref]:
            if isinstance(result, Failure):
                shard.given_up.setdefault(ref.name, replace(result, shard=shard.task.path))
            elif result.key:
                shard.keys[ref.name] = result.key
            self._needs[shard] -= 1
            if not self._needs[shard]:
                self._ready.append(shard)

    def _settle(self, shard: ShardAttempt, result: ShardResult) -> None:
        self._unsettled -= 1
        failed_frames = {failure.ref.name for failure in result.failures}
        lost = sum(len(variants) for ref, variants in shard.task.items if ref.name in failed_frames)
        self._progress.settled += shard.task.samples
        self._progress.lost += lost
        self._progress.lost_frames += len(failed_frames)
        self._results.settle(shard.task, result)
