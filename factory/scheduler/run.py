"""The run loop: shards to workers, results to the manifest, nothing lost on the way."""

from __future__ import annotations

import pickle
import shutil
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tqdm import tqdm

from factory.errors import FactoryError
from factory.frame import FrameRef
from factory.scheduler.attempts import Attempts
from factory.scheduler.journal import Progress, read_journal
from factory.scheduler.local import LocalBackend
from factory.scheduler.plan import ShardTask
from factory.scheduler.resume import take_up
from factory.scheduler.settings import SchedulerSettings
from factory.scheduler.signals import stop_signals
from factory.scheduler.worker import Recipe, ShardJob, ShardResult, run_job
from factory.shards.failures import Failure, FailureKind, save_failures
from factory.shards.files import explain_os_errors, remove_stale_temporaries
from factory.shards.folder import WORK_NAME
from factory.shards.manifest import Manifest, save_manifest
from factory.shards.schema import SPLITS

_POLL_S = 0.2
# So many workers that die without having begun a frame, one after another, are no accident.
_MAX_BARREN_DEATHS = 10


@dataclass(frozen=True)
class RunReport:
    """What a run did.

    samples, shards, bytes: what the dataset now holds; samples_by_split: train and test.
    kept: shards that an earlier run had finished.  failures: every frame without a sample.
    """

    samples: int
    samples_by_split: Mapping[str, int]
    shards: int
    bytes: int
    kept: int
    failures: tuple[Failure, ...]
    seconds: float


def run(
    tasks: Sequence[ShardTask],
    recipe: Recipe,
    manifest: Manifest,
    settings: SchedulerSettings,
    rerun_command: Callable[[FrameRef], str],
) -> RunReport:
    """Make every shard of `tasks` that `manifest` does not hold whole already.

    manifest.json and failed.jsonl are rewritten after each shard, so a run that is killed can be
    taken up where it was.

    Raises FactoryError when the job as a whole cannot be done (no room, no renderer, no worker
    that lives), and Interrupted on Ctrl-C or SIGTERM; no worker process outlives the call.
    """
    started = time.monotonic()
    with stop_signals():
        resumed = take_up(recipe.directory, tasks, manifest)
        for note in resumed.notes:
            tqdm.write(note, file=sys.stderr)
        loop = _Loop(recipe, resumed.manifest, settings, rerun_command)
        loop.run(tasks, resumed.todo, resumed.lacking)
    shards = loop.manifest.shards
    return RunReport(
        samples=loop.manifest.samples(),
        samples_by_split={split: loop.manifest.samples(split) for split in SPLITS},
        shards=len(shards),
        bytes=loop.manifest.total_bytes(),
        kept=len(tasks) - len(resumed.todo) + loop.kept,
        failures=tuple(
            failure for path in sorted(loop.failures) for failure in loop.failures[path]
        ),
        seconds=time.monotonic() - started,
    )


class _Loop:
    """State of one run."""

    def __init__(
        self,
        recipe: Recipe,
        manifest: Manifest,
        settings: SchedulerSettings,
        rerun_command: Callable[[FrameRef], str],
    ) -> None:
        self.manifest = manifest
        self.failures: dict[str, tuple[Failure, ...]] = {}
        self.kept = 0
        self._recipe, self._settings, self._rerun_command = recipe, settings, rerun_command
        self._work = recipe.directory / WORK_NAME
        self._waiting: deque[Attempts] = deque()
        self._flying: dict[Future[ShardResult], tuple[Attempts, Path]] = {}
        self._lacking: Mapping[str, tuple[str, ...]] = {}
        self._barren_deaths = 0
        self._settled_samples = 0

    def run(
        self,
        tasks: Sequence[ShardTask],
        todo: Sequence[ShardTask],
        lacking: Mapping[str, tuple[str, ...]],
    ) -> None:
        """Make the shards of `todo`; `lacking` names the frames that whole ones among them lack."""
        self._lacking = lacking
        self._save()
        if not todo:
            return
        self._clear_work()
        total = sum(task.samples for task in tasks)
        self._settled_samples = total - sum(task.samples for task in todo)
        self._waiting.extend(Attempts(task, self._settings.retries) for task in todo)
        frames = max(len(task.items) for task in todo)
        tty = sys.stderr.isatty()
        with tqdm(
            total=total,
            initial=self._settled_samples,
            unit="pair",
            desc="pairs",
            mininterval=0.1 if tty else 30.0,
            dynamic_ncols=tty,
        ) as bar:
            self._backend = LocalBackend(
                self._settings.worker_count(len(todo)),
                max(1, self._settings.recycle_frames // frames),
                self._settings.threads,
            )
            try:
                self._until_done(bar)
            finally:
                self._backend.stop()
                self._clear_work()
                for split in SPLITS:
                    remove_stale_temporaries(self._recipe.directory / split)

    def _until_done(self, bar: tqdm[Any]) -> None:
        while self._waiting or self._flying:
            while self._waiting and self._backend.free:
                self._submit(self._waiting.popleft())
            done, _ = wait(self._flying, timeout=_POLL_S, return_when=FIRST_COMPLETED)
            for future in done:
                self._settle(*self._flying.pop(future), future)
            self._show(bar)

    def _submit(self, attempts: Attempts) -> None:
        task = attempts.task
        attempts.number += 1
        journal = self._work / f"{task.path.replace('/', '-')}.{attempts.number}.journal"
        job = ShardJob(
            task, self._recipe, journal, attempts.given_up, self._lacking.get(task.path, ())
        )
        # The worker watches each frame itself; this is for one too stuck even for that.
        limit_s = (len(task.items) + 2) * self._settings.frame_timeout_s + 60.0
        future = self._backend.submit(run_job, pickle.dumps(job), limit_s)
        self._flying[future] = (attempts, journal)

    def _settle(self, attempts: Attempts, journal: Path, future: Future[ShardResult]) -> None:
        error = future.exception()
        progress = read_journal(journal)
        journal.unlink(missing_ok=True)
        if progress.begun or error is None:
            self._barren_deaths = 0
        if error is None:
            self._finish(attempts, future.result())
        else:
            self._blame(attempts, progress, error)

    def _finish(self, attempts: Attempts, result: ShardResult) -> None:
        task = attempts.task
        self._settled_samples += task.samples
        if result.kept:
            self.kept += 1
        elif result.info:
            self.manifest = self.manifest.with_shard(result.info)
        else:
            self.manifest = self.manifest.without(task.path)
            with explain_os_errors(self._recipe.directory / task.path):
                (self._recipe.directory / task.path).unlink(missing_ok=True)
        self.failures[task.path] = result.failures
        self._save()

    def _blame(self, attempts: Attempts, progress: Progress, error: BaseException) -> None:
        """A worker died: find out over what, and decide whether to try again."""
        reason = self._backend.why_died(error)
        kind: FailureKind = "crash"
        if isinstance(error, TimeoutError) or (reason and progress.timed_out):
            limit_s = self._settings.frame_timeout_s
            kind, reason = "timeout", f"took longer than scheduler.frame_timeout_s={limit_s:g}"
        elif reason is None:
            raise error
        if not progress.begun:
            # Nothing of this shard was touched yet, so nothing of it is to blame.
            self._barren_deaths += 1
            if self._barren_deaths >= _MAX_BARREN_DEATHS:
                raise FactoryError(f"no worker lives long enough to begin a frame: {reason}")
        elif not attempts.died(progress.in_hand, kind, reason):
            # A finished shard that was only asked for the frames it lacks is as good as before.
            lacking = self._lacking.get(attempts.task.path)
            failures = tuple(
                failure
                for failure in attempts.given_up
                if lacking is None or failure.ref.name in lacking
            )
            self._finish(attempts, ShardResult(None, failures, kept=lacking is not None))
            return
        self._waiting.appendleft(attempts)

    def _show(self, bar: tqdm[Any]) -> None:
        progress = [read_journal(journal) for _, journal in self._flying.values()]
        samples = self._settled_samples + sum(told.samples for told in progress)
        failed = sum(len(failures) for failures in self.failures.values())
        failed += sum(told.failed for told in progress)
        if failed:
            bar.set_postfix_str(f"{failed} failed", refresh=False)
        bar.update(samples - bar.n)

    def _save(self) -> None:
        # In this order: a shard in the manifest always has its failures on record.
        everything = [failure for failures in self.failures.values() for failure in failures]
        save_failures(self._recipe.directory, everything, self._rerun_command)
        save_manifest(self._recipe.directory, self.manifest)

    def _clear_work(self) -> None:
        shutil.rmtree(self._work, ignore_errors=True)
