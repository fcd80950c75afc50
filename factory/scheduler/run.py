"""One run: what is there is taken up, the rest is made, and nothing is lost on the way."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from tqdm import tqdm

from factory.frame import FrameRef
from factory.scheduler.backend import open_backend
from factory.scheduler.lock import Lock
from factory.scheduler.loop import Loop
from factory.scheduler.plan import ShardTask
from factory.scheduler.progress import Progress
from factory.scheduler.resume import take_up
from factory.scheduler.settings import SchedulerSettings
from factory.scheduler.signals import Interrupted
from factory.scheduler.worker import Recipe
from factory.shards.failures import Failure, save_failures
from factory.shards.files import remove_stale_temporaries
from factory.shards.manifest import Manifest, save_manifest
from factory.shards.schema import SPLITS


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
    lock: Lock,
    part: str = "",
    keep_cache_within: Callable[[int], None] = lambda added_bytes: None,
) -> RunReport:
    """Make every shard of `tasks` that `manifest` does not hold whole already.

    manifest.json and failed.jsonl are rewritten after each shard, so a run that is killed can be
    taken up where it was.
    part: name of the slice of the dataset that `tasks` are; empty for the whole.
    keep_cache_within: told how many bytes were added whenever a frame was prepared.

    Raises FactoryError when the job as a whole cannot be done (no room, no renderer, no worker
    that lives), and Interrupted on Ctrl-C or SIGTERM; no worker process outlives the call.
    """
    started = time.monotonic()
    resumed = take_up(recipe.directory, tasks, manifest, whole=not part)
    for note in resumed.notes:
        tqdm.write(note, file=sys.stderr)
    todo, directory = resumed.todo, recipe.directory
    frames = len({ref.name for task in todo for ref, _ in task.items}) if recipe.preparer else 0
    crew = settings.crew(len(todo), frames)
    total = sum(task.samples for task in tasks)
    settled = total - sum(task.samples for task in todo)
    progress = Progress(directory, total, settled, crew, part)
    loop = Loop(recipe, resumed.manifest, settings, resumed.lacking, progress, lock)
    loop.on_prepared = keep_cache_within

    def save() -> None:
        # In this order: a shard in the manifest always has its failures on record.
        everything = [failure for failures in loop.failures.values() for failure in failures]
        save_failures(directory, everything, rerun_command, part)
        save_manifest(directory, loop.manifest, part)

    save()
    state = "broken"
    try:
        if todo:
            loop.clear_work()
            loop.add(todo)
            largest = max(len(task.items) for task in todo)
            per_worker = max(1, settings.recycle_frames // largest)
            backend = open_backend(
                settings, crew, {"render": settings.recycle_frames, "noise": per_worker}
            )
            try:
                loop.run(backend, save)
            finally:
                backend.stop()
                loop.clear_work()
                for split in SPLITS:
                    remove_stale_temporaries(directory / split)
        state = "finished"
    except Interrupted:
        state = "stopped"
        raise
    finally:
        progress.close(state)
    shards = loop.manifest.shards
    return RunReport(
        samples=loop.manifest.samples(),
        samples_by_split={split: loop.manifest.samples(split) for split in SPLITS},
        shards=len(shards),
        bytes=loop.manifest.total_bytes(),
        kept=len(tasks) - len(todo) + loop.kept,
        failures=tuple(
            failure for path in sorted(loop.failures) for failure in loop.failures[path]
        ),
        seconds=time.monotonic() - started,
    )
