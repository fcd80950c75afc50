"""What a run has settled: kept in memory, and on disk so that a killed run loses none of it.

manifest.json is written at the start, now and then, and at the end; manifest.jsonl has what came
since; failed.jsonl takes the failures of a shard before the shard counts as settled, and is put in
order at the end.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

from ..dataset.format.manifest import Additions, Manifest, save_manifest
from ..dataset.format.schema import SPLITS
from ..dataset.write.failures import Failure, add_failures, save_failures
from ..files import explain_os_errors, remove_file
from ..ownership import check_fences
from .job import Job
from .plan import ShardTask
from .worker import ShardResult

# manifest.json is written so seldom that it takes at most this part of the time.
_SAVING_SHARE = 0.02
_SAVING_EVERY_S = 30.0


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


class Ledger:
    """The settled shards of one run and the failures of their frames.

    manifest: the shards that were there before the run and are whole.
    """

    def __init__(self, job: Job, manifest: Manifest) -> None:
        self._job, self._manifest = job, manifest
        self._begun = time.monotonic()
        self._shards = dict(manifest.shards)
        self._failures: dict[str, tuple[Failure, ...]] = {}
        self._kept = 0
        self._additions = Additions(job.directory, job.shard.part)
        self._save_from = 0.0

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Of all settled shards, in the order of their paths."""
        return tuple(failure for path in sorted(self._failures) for failure in self._failures[path])

    def settle(self, task: ShardTask, result: ShardResult) -> None:
        """Put the outcome of a shard on record; a shard without a sample has no file."""
        if result.kept:
            self._kept += 1
        elif result.info:
            self._shards[task.path] = result.info
        else:
            self._shards.pop(task.path, None)
            path = self._job.recipe.directory / task.path
            check_fences(path)
            with explain_os_errors(path):
                remove_file(path)
        self._failures[task.path] = result.failures
        # In this order: a shard in the manifest always has its failures on record.
        if result.failures:
            job = self._job
            add_failures(job.directory, result.failures, job.rerun_command, job.shard.part)
        if time.monotonic() >= self._save_from:
            self.save()
        else:
            self._additions.note(task.path, self._shards.get(task.path))

    def save(self) -> None:
        """Write manifest.json, which makes manifest.jsonl empty."""
        begun = time.monotonic()
        save_manifest(self._job.directory, self._current(), self._job.shard.part)
        ended = time.monotonic()
        self._save_from = ended + max(_SAVING_EVERY_S, (ended - begun) / _SAVING_SHARE)

    def save_failures(self) -> None:
        """Write failed.jsonl anew: in order, each failure once."""
        job = self._job
        save_failures(job.directory, self.failures, job.rerun_command, job.shard.part)

    def report(self, already_done: int) -> RunReport:
        """What the run did; `already_done`: shards in which nothing was left to do."""
        manifest = self._current()
        return RunReport(
            samples=manifest.samples(),
            samples_by_split={split: manifest.samples(split) for split in SPLITS},
            shards=len(manifest.shards),
            bytes=manifest.total_bytes(),
            kept=already_done + self._kept,
            failures=self.failures,
            seconds=time.monotonic() - self._begun,
        )

    def _current(self) -> Manifest:
        return replace(self._manifest, shards=dict(self._shards))
