"""What runs have settled: each shard's result lies beside it, and is put together at the end.

train/shard-00000.json says what became of train/shard-00000.h5, whoever made it: a run, a slice of
it on another machine, or one that was killed.  At the end manifest.json and failed.jsonl take up
all of them, and they go.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

from ..dataset.manifest import (
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
from ..dataset.schema import SPLITS
from ..files import explain_os_errors, remove_file
from .plan import Job, ShardTask
from .worker import ShardResult


@dataclass(frozen=True)
class RunReport:
    """What a run did.

    samples, shards, bytes: what the dataset now holds; samples_by_split: train and test.
    kept: shards that an earlier run had finished.  failures: every frame without a sample.
    frames: that were asked for.
    """

    samples: int
    samples_by_split: Mapping[str, int]
    shards: int
    bytes: int
    kept: int
    failures: tuple[Failure, ...]
    seconds: float
    frames: int = 0


@dataclass(frozen=True)
class Resumed:
    """Where a run starts.

    manifest: the shards that are whole.
    todo: tasks to make, or to try again because they lack frames.
    lacking: path of such a shard -> names of the frames it lacks.
    notes: one line about each shard that was found damaged.
    """

    manifest: Manifest
    todo: tuple[ShardTask, ...]
    lacking: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...]


def take_up(job: Job, manifest: Manifest) -> Resumed:
    """Compare plan, results and disk."""
    tasks = {task.path: task for task in job.own_tasks}
    there = [info for path, info in manifest.shards.items() if path in tasks]
    with ThreadPoolExecutor() as pool:
        problems = list(pool.map(partial(damage, job.directory), there))
    good = {i.path: i for i, problem in zip(there, problems, strict=True) if not problem}
    notes = tuple(
        f"{job.directory / info.path}: {problem}; it is made again"
        for info, problem in zip(there, problems, strict=True)
        if problem
    )
    todo = tuple(
        task
        for path, task in tasks.items()
        if path not in good or good[path].samples < task.samples
    )
    lacking = {task.path: good[task.path].failed for task in todo if task.path in good}
    return Resumed(_with_shards(manifest, good), todo, lacking, notes)


def _with_shards(manifest: Manifest, shards: Mapping[str, ShardInfo]) -> Manifest:
    """The manifest with these shards; an index.h5 that shows others counts no more."""
    index = manifest.index_sha256 if shards == manifest.shards else ""
    return replace(manifest, shards=dict(shards), index_sha256=index)


class Results:
    """The settled shards of one run and the failures of their frames.

    manifest: the shards that were there before the run and are whole.
    """

    def __init__(self, job: Job, manifest: Manifest) -> None:
        self._job, self._manifest = job, manifest
        self._begun = time.monotonic()
        self._shards = dict(manifest.shards)
        self._failures: dict[str, tuple[Failure, ...]] = {}
        self._kept = 0

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Of all settled shards, in the order of their paths."""
        return tuple(failure for path in sorted(self._failures) for failure in self._failures[path])

    def settle(self, task: ShardTask, result: ShardResult) -> None:
        """Put the outcome of a shard on disk; a shard without a sample has no file."""
        info = self._shards.get(task.path) if result.kept else result.info
        self._kept += result.kept
        if info is None:
            self._shards.pop(task.path, None)
            path = self._job.recipe.directory / task.path
            with explain_os_errors(path):
                remove_file(path)
        else:
            self._shards[task.path] = info
        self._failures[task.path] = result.failures
        told = failure_lines(result.failures, self._job.rerun_command)
        hash_ = self._manifest.config_hash
        save_outcome(self._job.directory, task.path, hash_, info, told)

    def put_together(self) -> None:
        """Write manifest.json and failed.jsonl of all that is settled; the results beside go.

        At the start, with what is whole of earlier runs, and at the end; a run that was stopped
        between leaves what it made beside its shards.  A slice leaves that to the run of the whole.
        """
        if self._job.shard.part:
            return
        directory = self._job.directory
        save_failures(directory, failure_lines(self.failures, self._job.rerun_command))
        save_manifest(directory, _with_shards(self._manifest, self._shards))
        forget_outcomes(directory)

    def report(self, already_done: int) -> RunReport:
        """What the run did; `already_done`: shards in which nothing was left to do."""
        manifest = replace(self._manifest, shards=dict(self._shards))
        refs = {ref.name for task in self._job.own_tasks for ref, _ in task.items}
        return RunReport(
            samples=manifest.samples(),
            samples_by_split={split: manifest.samples(split) for split in SPLITS},
            shards=len(manifest.shards),
            bytes=manifest.total_bytes(),
            kept=already_done + self._kept,
            failures=self.failures,
            seconds=time.monotonic() - self._begun,
            frames=len(refs),
        )
