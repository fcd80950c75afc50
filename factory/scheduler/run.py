"""From a job to a finished dataset folder: shards, manifest, failures, preview, descriptions."""

from __future__ import annotations

import shutil
from pathlib import Path

from ..dataset.card import write_card
from ..dataset.folder import open_folder
from ..dataset.manifest import Manifest, load_manifest
from ..dataset.preview import preview
from ..dataset.schema import SPLITS
from ..dataset.writer import write_index
from ..errors import FactoryError
from ..files import explain_os_errors, remove_file, remove_stale_temporaries
from ..progress import stage
from ..storage.publish import Publication, publishing
from .lock import Lock
from .loop import Loop
from .plan import Job, work_folder
from .progress import ProgressBar
from .results import Results, RunReport, take_up
from .workers import workers_of
from .workers.signals import Interrupted, stop_signals


def make_dataset(job: Job) -> RunReport:
    """Make the dataset of `job`, or finish it; running the same again keeps what is whole.

    Raises FactoryError when the folder is another dataset's, cannot be written, nothing was
    planned, or the job as a whole cannot be done (no room, no renderer, no worker that lives);
    Interrupted (a KeyboardInterrupt with `exit_code`) on Ctrl-C and SIGTERM.
    """
    if not job.tasks:
        raise FactoryError("nothing to make: no frame was chosen, or max_train and max_test are 0")
    apart = job.scheduler.address is not None
    with (
        stop_signals(),
        Lock(job.directory, job.shard.part),
        publishing(job.directory, job.shard.part, apart=apart) as publication,
    ):
        manifest = open_folder(job.directory, job.config_values, job.provenance)
        report = make_shards(job, manifest, publication)
        if not job.shard.part:
            _forget_slices(job.directory)
            _describe(job, report)
    return report


def make_shards(job: Job, manifest: Manifest, publication: Publication | None = None) -> RunReport:
    """Make every shard of the job that `manifest` does not hold whole already.

    Raises as `make_dataset` does.  No worker process outlives the call.
    """
    tasks = job.own_tasks
    resumed = take_up(job, manifest)
    for note in resumed.notes:
        stage(note)
    todo = resumed.todo
    # Workers that share no folder prepare what they need themselves.
    prepares = job.preparer and not (publication and publication.apart)
    frames = len({ref.name for task in todo for ref, _ in task.items}) if prepares else 0
    crew, note = job.scheduler.within_limits(job.scheduler.crew(len(todo), frames))
    if note:
        stage(note)
    total = sum(task.samples for task in tasks)
    progress = ProgressBar(job, crew, total, total - sum(task.samples for task in todo))
    results = Results(job, resumed.manifest)
    results.put_together()
    state = "broken"
    try:
        # Also when nothing is left to do: a run may have been killed after its last shard.
        _tidy(job)
        if todo:
            count = f"{crew.total} worker{'s' if crew.total > 1 else ''}"
            renders = f" ({crew.render} of them for renders)" if crew.render else ""
            stage(f"starting {count}{renders} for {sum(task.samples for task in todo)} pairs")
            largest = max(len(task.items) for task in todo)
            try:
                settings = job.scheduler.worker_settings(crew, largest, job.preload)
                with workers_of(settings) as backend:
                    Loop(job, resumed, results, progress, backend, publication).run()
            finally:
                _tidy(job)
        results.put_together()
        state = "finished"
    except BaseException as error:
        state = "stopped" if isinstance(error, Interrupted) else "broken"
        raise
    finally:
        progress.close(state)
    return results.report(already_done=len(tasks) - len(todo))


def _tidy(job: Job) -> None:
    """Remove what crashed workers and dead writers left."""
    shutil.rmtree(work_folder(job.directory, job.shard), ignore_errors=True)
    for split in SPLITS:
        remove_stale_temporaries(job.directory / split)


def _describe(job: Job, report: RunReport) -> None:
    """Write all that stands beside the shards."""
    finished = load_manifest(job.directory)
    if finished is not None and report.samples:
        stage(f"writing index, card{' and preview' if job.dataset.preview_pairs else ''}")
        write_index(job.directory, finished)
        if job.dataset.preview_pairs:
            preview(job.directory, pairs=job.dataset.preview_pairs, trusted=True)
        write_card(
            job.directory, finished, job.provenance, job.dataset, report.failures, job.skipped
        )


def _forget_slices(directory: Path) -> None:
    """Remove the states of slices, and what earlier versions left."""
    for path in (*directory.glob("*.*-of-*.json*"), *directory.glob("croissant.json")):
        with explain_os_errors(path):
            remove_file(path)
