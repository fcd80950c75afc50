"""From a job to a finished dataset folder: shards, manifest, failures, preview, descriptions."""

from __future__ import annotations

import shutil
from contextlib import closing
from dataclasses import replace

from ...common.errors import FactoryError
from ...common.files import remove_stale_temporaries
from ...common.signals import Interrupted, stop_signals
from ...common.workers import Backend, Pool
from ...common.workers.local import LocalBackend
from ...common.workers.settings import NOISE, RENDER, WorkerCounts
from ...dataset.card import write_card
from ...dataset.folder import open_folder
from ...dataset.manifest import Manifest, load_manifest
from ...dataset.preview import preview
from ...dataset.schema import SPLITS
from ...dataset.writer import write_index
from .lock import locked, publishing
from .loop import ShardLoop
from .plan import DatasetJob, work_folder
from .progress import ProgressBar
from .results import Results, RunReport


def make_dataset(job: DatasetJob) -> RunReport:
    """Make the dataset of `job`, or finish it; running the same again keeps what is whole.

    Raises FactoryError when the folder is another dataset's, cannot be written, nothing was
    planned, or the job as a whole cannot be done (no room, no renderer, no worker that lives);
    Interrupted (a KeyboardInterrupt with `exit_code`) on Ctrl-C and SIGTERM.  No worker process
    outlives the call.
    """
    if not job.tasks:
        raise FactoryError("nothing to make: no frame was chosen, or max_train and max_test are 0")
    is_remote = job.scheduler.address is not None
    with (
        stop_signals(),
        locked(job.directory, job.shard.part),
        publishing(job.directory, job.shard.part, is_remote=is_remote) as publication,
    ):
        manifest = open_folder(job.directory, job.config_values, job.provenance)
        report = _make_shards(replace(job, publication=publication), manifest)
        if not job.shard.part:
            for path in job.directory.glob("status.*-of-*.json"):
                path.unlink(missing_ok=True)
            _describe(job, report)
    return report


def _make_shards(job: DatasetJob, manifest: Manifest) -> RunReport:
    """Make every shard of the job that `manifest` does not hold whole already."""
    results = Results(job, manifest)
    todo = results.todo
    frames = len({ref.name for task in todo for ref, _ in task.items}) if job.prepares else 0
    worker_counts = job.scheduler.worker_counts(len(todo), frames)
    total, left = (sum(task.samples for task in tasks) for tasks in (job.own_tasks, todo))
    progress = ProgressBar(job, total, total - left)
    results.write_manifest()
    state = "broken"
    try:
        # Also when nothing is left to do: a run may have been killed after its last shard.
        _tidy(job)
        if todo:
            job.reporter.stage(_starting_text(job, worker_counts, left))
            try:
                with closing(
                    _backend(job, worker_counts, max(len(task.items) for task in todo))
                ) as backend:
                    ShardLoop(job, results, progress, backend).run()
            finally:
                _tidy(job)
        results.write_manifest()
        state = "finished"
    except Interrupted:
        state = "stopped"
        raise
    finally:
        progress.close(state)
    return results.report()


def _starting_text(job: DatasetJob, worker_counts: WorkerCounts, pairs: int) -> str:
    """The line that says who makes the pairs."""
    if job.scheduler.backend == "serial":
        return f"making {pairs} pairs in this process"
    count = f"{worker_counts.total} worker{'s' if worker_counts.total > 1 else ''}"
    renders = f" ({worker_counts.render} of them for renders)" if worker_counts.render else ""
    return f"starting {count}{renders} for {pairs} pairs"


def _backend(job: DatasetJob, worker_counts: WorkerCounts, frames_per_shard: int) -> Backend:
    """What runs the tasks.  Raises FactoryError when it cannot be had."""
    if job.scheduler.backend == "serial":
        return Backend()
    if job.scheduler.backend == "dask":
        # Half a second of imports, and an optional dependency.
        from .dask_cluster import DaskBackend

        return DaskBackend(worker_counts.total, job.scheduler.address)
    frames = job.scheduler.recycle_frames
    heavy = Pool((RENDER, NOISE), worker_counts.render, frames)
    light = Pool((NOISE,), worker_counts.noise, max(1, frames // frames_per_shard))
    return LocalBackend((heavy, light), job.preload)


def _tidy(job: DatasetJob) -> None:
    """Remove what crashed workers and dead writers left."""
    shutil.rmtree(work_folder(job.directory, job.shard), ignore_errors=True)
    for split in SPLITS:
        remove_stale_temporaries(job.directory / split)


def _describe(job: DatasetJob, report: RunReport) -> None:
    """Write all that stands beside the shards."""
    if (finished := load_manifest(job.directory)) is not None and report.samples:
        with_preview = " and preview" if job.dataset.preview_pairs else ""
        job.reporter.stage(f"writing index, card{with_preview}")
        write_index(job.directory, finished)
        if job.dataset.preview_pairs:
            preview(job.directory, pairs=job.dataset.preview_pairs, trusted=True)
        write_card(
            job.directory,
            finished,
            job.provenance,
            job.dataset,
            report.failures,
            job.skipped,
            job.config_values,
            job.facts(job.directory),
        )
