"""The run loop: frames to render workers, shards to noise workers, results to the manifest.

Two queues and no barrier: a shard is made as soon as its own frames are prepared, and shards that
can be made go before frames that can be prepared.
"""

from __future__ import annotations

import pickle
import shutil
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import replace
from typing import Any

from simnfnd.factory.dataset.format.manifest import Manifest
from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.dataset.write.failures import Failure, FailureKind
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import explain_os_errors
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.jobs.attempts import Attempts, Preparation, backoff_s
from simnfnd.factory.jobs.journal import read_journal
from simnfnd.factory.jobs.lock import Lock
from simnfnd.factory.jobs.log import ShardLog
from simnfnd.factory.jobs.plan import ShardTask
from simnfnd.factory.jobs.progress import Progress
from simnfnd.factory.jobs.settings import SchedulerSettings
from simnfnd.factory.jobs.worker import (
    PrepareJob,
    PrepareResult,
    Recipe,
    ShardJob,
    ShardResult,
    run_job,
    run_prepare,
)
from simnfnd.factory.workers.backend import Backend

_POLL_S = 0.2
# So many workers that die without having begun a frame, one after another, are no accident.
_MAX_BARREN_DEATHS = 10
# A shard whose frames vanish from the cache that often will not be made.
_MAX_ROUNDS = 20

Work = Attempts | Preparation


class Loop:
    """State of one run.

    provenances: path -> what a shard is to state, where it is not what the recipe says.
    """

    def __init__(
        self,
        recipe: Recipe,
        manifest: Manifest,
        settings: SchedulerSettings,
        lacking: Mapping[str, tuple[str, ...]],
        progress: Progress,
        lock: Lock,
    ) -> None:
        self.shards = dict(manifest.shards)
        self.failures: dict[str, tuple[Failure, ...]] = {}
        self.kept = 0
        self.on_prepared: Callable[[int], None] = lambda added_bytes: None
        self.provenances: Mapping[str, Provenance] = {}
        self._manifest, self._failed = manifest, 0
        self._recipe, self._settings, self._lacking = recipe, settings, lacking
        self._progress, self._lock = progress, lock
        self._work = recipe.work_folder
        self._log = ShardLog(recipe.directory)
        self._ready: deque[Attempts] = deque()
        self._preparing: deque[Preparation] = deque()
        self._waiting: dict[str, Preparation] = {}
        self._open = 0
        self._flying: dict[Future[Any], tuple[Work, Any]] = {}
        self._barren_deaths = 0

    def add(self, todo: Sequence[ShardTask]) -> None:
        """Take these shards up."""
        for task in todo:
            attempts = Attempts(task, self._settings.retries)
            self._open += 1
            if self._recipe.preparer is None:
                self._ready.append(attempts)
                continue
            lacking = self._lacking.get(task.path)
            self._need(
                attempts, [ref for ref, _ in task.items if lacking is None or ref.name in lacking]
            )
        self._progress.frames_total = len(self._waiting)

    @property
    def frames_to_prepare(self) -> int:
        """Frames that wait for a render worker."""
        return len(self._preparing)

    @property
    def manifest(self) -> Manifest:
        """The shards that are finished by now."""
        return replace(self._manifest, shards=dict(self.shards))

    def run(self, backend: Backend, settled: Callable[[str], None]) -> None:
        """Go on until every shard is settled; `settled` is told the path of each that is."""
        self._backend, self._settled = backend, settled
        while self._open:
            self._submit_what_fits()
            done, _ = wait(self._flying, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            if not self._flying:
                time.sleep(0.01)  # all that is left waits for its next try
            for future in done:
                self._settle(*self._flying.pop(future), future)
            backend.poll()
            self._lock.beat()
            self._progress.show(
                [journal for work, journal in self._flying.values() if isinstance(work, Attempts)],
                self._failed,
            )

    def _submit_what_fits(self) -> None:
        now = time.monotonic()
        while self._backend.free("noise") and (attempts := _take(self._ready, now)):
            self._submit_shard(attempts)
        while self._backend.free("render") and (frame := _take(self._preparing, now)):
            self._submit_frame(frame)

    def _submit_shard(self, attempts: Attempts) -> None:
        task = attempts.task
        attempts.number += 1
        journal = self._work / f"{task.path.replace('/', '-')}.{attempts.number}.journal"
        recipe = self._recipe
        if task.path in self.provenances:
            recipe = replace(recipe, provenance=self.provenances[task.path])
        job = ShardJob(task, recipe, journal, attempts.given_up, self._lacking.get(task.path, ()))
        # The worker watches each frame itself; this is for one too stuck even for that.
        limit_s = (len(task.items) + 2) * self._settings.frame_timeout_s + 60.0
        future = self._backend.submit(run_job, pickle.dumps(job), limit_s, "noise")
        self._flying[future] = (attempts, journal)

    def _submit_frame(self, frame: Preparation) -> None:
        frame.number += 1
        name = frame.ref.name.replace("/", "-")
        journal = self._work / f"{name}.{frame.number}.journal"
        job = PrepareJob(frame.ref, self._recipe, journal)
        limit_s = 3 * self._settings.frame_timeout_s + 60.0
        future = self._backend.submit(run_prepare, pickle.dumps(job), limit_s, "render")
        self._flying[future] = (frame, journal)

    def _settle(self, work: Work, journal: Any, future: Future[Any]) -> None:
        error = future.exception()
        told = read_journal(journal)
        if told.begun or error is None:
            self._barren_deaths = 0
        if error is None:
            journal.unlink(missing_ok=True)
            result = future.result()
            if isinstance(work, Preparation):
                self._prepared(work, result)
            elif result.missing:
                self._need_again(work, result.missing)
            else:
                self._finish(work, result)
            return
        kind, reason = self._why(error, told.timed_out)
        self._log.death(work, reason, journal)
        journal.unlink(missing_ok=True)
        if not told.begun:
            # Nothing of it was touched yet, so nothing of it is to blame.
            self._barren_deaths += 1
            if self._barren_deaths >= _MAX_BARREN_DEATHS:
                raise FactoryError(f"no worker lives long enough to begin a frame: {reason}")
            again = True
        elif isinstance(work, Preparation):
            failure = work.died(kind, reason)
            again = failure is None
            if failure is not None:
                self._prepared(work, PrepareResult(failure))
        else:
            again = work.died(told.in_hand, kind, reason)
            if not again:
                self._give_up(work)
        if again:
            self._again(work, told.begun)

    def _again(self, work: Work, begun: bool) -> None:
        deaths = work.deaths if begun else self._barren_deaths
        work.not_before = time.monotonic() + backoff_s(self._settings.backoff_s, deaths)
        if isinstance(work, Preparation):
            self._preparing.appendleft(work)
        else:
            self._ready.appendleft(work)

    def _why(self, error: BaseException, timed_out: bool) -> tuple[FailureKind, str]:
        """Why a worker died; an error that is no death ends the run."""
        reason = self._backend.why_died(error)
        if isinstance(error, TimeoutError) or (reason and timed_out):
            limit_s = self._settings.frame_timeout_s
            return "timeout", f"took longer than scheduler.frame_timeout_s={limit_s:g}"
        if reason is None:
            raise error
        return "crash", reason

    def _need(self, attempts: Attempts, refs: Sequence[FrameRef]) -> None:
        """Let the shard wait until these frames are prepared."""
        for ref in refs:
            if ref.name not in self._waiting:
                self._waiting[ref.name] = Preparation(ref, self._settings.retries)
                self._preparing.append(self._waiting[ref.name])
            self._waiting[ref.name].waiting.append(attempts)
            attempts.needs.add(ref.name)

    def _need_again(self, attempts: Attempts, missing: Sequence[FrameRef]) -> None:
        attempts.rounds += 1
        if attempts.rounds > _MAX_ROUNDS or self._recipe.preparer is None:
            raise FactoryError(
                f"{missing[0].name}: its render vanishes from the cache before it is used; "
                "raise cache.max_bytes, it must hold the frames of a shard for every worker"
            )
        self._need(attempts, missing)
        self._progress.frames_total += len(missing)

    def _prepared(self, frame: Preparation, result: PrepareResult) -> None:
        del self._waiting[frame.ref.name]
        self._progress.prepared(result.hit, result.failure is not None)
        self.on_prepared(result.bytes)
        for attempts in frame.waiting:
            if result.failure is not None:
                attempts.give_up(result.failure)
            attempts.needs.discard(frame.ref.name)
            if not attempts.needs:
                self._ready.append(attempts)

    def _give_up(self, attempts: Attempts) -> None:
        # A finished shard that was only asked for the frames it lacks is as good as before.
        lacking = self._lacking.get(attempts.task.path)
        failures = tuple(
            failure
            for failure in attempts.given_up
            if lacking is None or failure.ref.name in lacking
        )
        self._finish(attempts, ShardResult(None, failures, kept=lacking is not None))

    def _finish(self, attempts: Attempts, result: ShardResult) -> None:
        task = attempts.task
        self._open -= 1
        self._progress.settled_samples += task.samples
        if result.kept:
            self.kept += 1
        elif result.info:
            self.shards[task.path] = result.info
        else:
            self.shards.pop(task.path, None)
            with explain_os_errors(self._recipe.directory / task.path):
                (self._recipe.directory / task.path).unlink(missing_ok=True)
        self.failures[task.path] = result.failures
        self._failed += len(result.failures)
        self._log.finished(attempts, result)
        self._settled(task.path)

    def clear_work(self) -> None:
        """Remove what workers left for us to read."""
        shutil.rmtree(self._work, ignore_errors=True)


def _take(queue: deque[Any], now: float) -> Any:
    """The first of the queue whose time has come, or None."""
    for index, work in enumerate(queue):
        if work.not_before <= now:
            del queue[index]
            return work
    return None
