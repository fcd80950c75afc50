"""What runs have settled: each shard's result lies beside it, and is put together at the end.

train/shard-00000.json says what became of train/shard-00000.h5, whoever made it: a run, a slice of
it on another machine, or one that was killed.  At the end manifest.json and failed.jsonl take up
all of them, and they go.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

from ...common.files import explain_os_errors, remove_file
from ...dataset.manifest import (
    Failure,
    Manifest,
    ShardInfo,
    damage,
    failure_lines,
    forget_outcomes,
    save_failures,
    save_manifest,
    save_outcome,
)
from .plan import DatasetJob, ShardTask
from .worker import ShardResult


@dataclass(frozen=True)
class RunReport:
    """What a run made, and what failed.

    samples: what the dataset now holds.  reused_shards: shards that an earlier run had finished.
    failures: every frame without a sample.  frames: that were asked for.
    """

    samples: int
    reused_shards: int
    failures: tuple[Failure, ...]
    frames: int


class Results:
    """The settled shards of one run and the failures of their frames.

    todo: tasks to make, or to try again because they lack frames.
    lacking: path of such a shard -> names of the frames it lacks.
    """

    def __init__(self, job: DatasetJob, manifest: Manifest) -> None:
        """Compare plan, results and disk; say which shards are damaged."""
        self._job = job
        self._manifest = manifest
        tasks = {task.path: task for task in job.own_tasks}
        listed_shards = [info for path, info in manifest.shards.items() if path in tasks]
        with ThreadPoolExecutor() as pool:
            problems = list(pool.map(partial(damage, job.directory), listed_shards))
        self._shards: dict[str, ShardInfo] = {}
        for info, problem in zip(listed_shards, problems, strict=True):
            inputs = tasks[info.path].inputs
            if not problem and info.inputs and inputs and info.inputs != inputs:
                problem = "its frames' files have changed"
            if problem:
                path = job.directory / info.path
                job.reporter.stage(f"{path}: {problem}; it is made again")
            else:
                self._shards[info.path] = info
        good = self._shards
        self.todo = [
            task
            for path, task in tasks.items()
            if path not in good or good[path].samples < task.samples
        ]
        again = (task.path for task in self.todo if task.path in good)
        self.lacking = {path: good[path].failed for path in again}
        self._reused_shards = len(tasks) - len(self.todo)
        self._failures: dict[str, tuple[Failure, ...]] = {}

    def settle(self, task: ShardTask, result: ShardResult) -> None:
        """Put the outcome of a shard on disk; a shard without a sample has no file."""
        info = self._shards.get(task.path) if result.keeps_file else result.info
        self._reused_shards += result.keeps_file
        if info is None:
            self._shards.pop(task.path, None)
            path = self._job.directory / task.path
            with explain_os_errors(path):
                remove_file(path)
        else:
            self._shards[task.path] = info
        self._failures[task.path] = result.failures
        lines = failure_lines(result.failures, self._job.rerun_command)
        hash_ = self._manifest.config_hash
        save_outcome(self._job.directory, task.path, hash_, info, lines)

    def write_manifest(self) -> None:
        """Write manifest.json and failed.jsonl of all that is settled; the results beside go.

        At the start, with what is whole of earlier runs, and at the end; a run that was stopped
        between leaves what it made beside its shards.  A slice leaves that to the run of the whole.
        """
        if self._job.shard.part:
            return
        directory = self._job.directory
        save_failures(directory, failure_lines(self.report().failures, self._job.rerun_command))
        # An index.h5 that shows other shards counts no more.
        whole = self._shards == self._manifest.shards
        index = self._manifest.index_sha256 if whole else ""
        manifest = replace(self._manifest, shards=dict(self._shards), index_sha256=index)
        save_manifest(directory, manifest)
        forget_outcomes(directory)

    def report(self) -> RunReport:
        """What the run did until now."""
        return RunReport(
            samples=sum(info.samples for info in self._shards.values()),
            reused_shards=self._reused_shards,
            failures=tuple(
                failure for path in sorted(self._failures) for failure in self._failures[path]
            ),
            frames=len({ref.name for task in self._job.own_tasks for ref, _ in task.items}),
        )
