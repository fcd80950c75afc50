"""One run: what is there is taken up, the rest is made, and nothing is lost on the way."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from simnfnd.factory.dataset.format.manifest import Additions, Manifest, save_manifest
from simnfnd.factory.dataset.format.schema import SPLITS, Provenance
from simnfnd.factory.dataset.write.failures import Failure, save_failures
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import remove_stale_temporaries
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.jobs.lock import Lock
from simnfnd.factory.jobs.loop import Loop
from simnfnd.factory.jobs.plan import ShardTask
from simnfnd.factory.jobs.progress import Progress
from simnfnd.factory.jobs.resume import take_up
from simnfnd.factory.jobs.settings import Kind, SchedulerSettings
from simnfnd.factory.jobs.worker import Recipe
from simnfnd.factory.workers.kept import give_back, lease
from simnfnd.factory.workers.signals import Interrupted

# manifest.json is written anew so seldom that it takes at most this part of the time.
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


class _Pace:
    """`with pace:` around what is not to be done too often; `due` when it may be done again."""

    def __init__(self) -> None:
        self._begun = self._next = 0.0

    @property
    def due(self) -> bool:
        return time.monotonic() >= self._next

    def __enter__(self) -> None:
        self._begun = time.monotonic()

    def __exit__(self, *_: object) -> None:
        ended = time.monotonic()
        wait_s = max(_SAVING_EVERY_S, (ended - self._begun) / _SAVING_SHARE)
        self._next = ended + wait_s


def _tidy(loop: Loop, directory: Path) -> None:
    """Away with journals, and with what dead writers left half written."""
    loop.clear_work()
    for split in SPLITS:
        remove_stale_temporaries(directory / split)


def run(
    tasks: Sequence[ShardTask],
    recipe: Recipe,
    manifest: Manifest,
    settings: SchedulerSettings,
    rerun_command: Callable[[FrameRef], str],
    lock: Lock,
    part: str = "",
    keep_cache_within: Callable[[int], None] = lambda added_bytes: None,
    provenances: Mapping[str, Provenance] | None = None,
) -> RunReport:
    """Make every shard of `tasks` that `manifest` does not hold whole already.

    Every shard is on record as soon as it is settled, so a run that is killed can be taken up
    where it was: manifest.json is written at the start, now and then, and at the end, and
    manifest.jsonl has what came since.
    provenances: path -> what a shard states that an earlier run with other settings has made.
    part: name of the slice of the dataset that `tasks` are; empty for the whole.
    keep_cache_within: told how many bytes were added whenever a frame was prepared.

    Raises FactoryError when the job as a whole cannot be done (no room, no renderer, no worker
    that lives), and Interrupted on Ctrl-C or SIGTERM.  No worker process outlives the call, unless
    it ended well and `kept.keep_workers` was called before.
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

    loop.provenances = provenances or {}
    additions, saving = Additions(directory, part), _Pace()

    def save_failed() -> None:
        everything = [failure for failures in loop.failures.values() for failure in failures]
        save_failures(directory, everything, rerun_command, part)

    def save() -> None:
        with saving:
            save_manifest(directory, loop.manifest, part)

    def on_record(path: str) -> None:
        # In this order: a shard in the manifest always has its failures on record.
        if loop.failures[path]:
            save_failed()
        if saving.due:
            save()
        else:
            additions.note(path, loop.shards.get(path))

    save_failed()
    save()
    state = "broken"
    try:
        # Also when nothing is left to do: a run may have been killed after its last shard.
        _tidy(loop, directory)
        if todo:
            loop.add(todo)
            largest = max(len(task.items) for task in todo)
            per_worker = max(1, settings.recycle_frames // largest)
            tasks_per_worker: dict[Kind, int] = {
                "render": settings.recycle_frames,
                "noise": per_worker,
            }
            backend = lease(settings, crew, tasks_per_worker)
            try:
                loop.run(backend, on_record)
            except BaseException:
                backend.stop()
                raise
            else:
                give_back(backend, settings, crew, tasks_per_worker)
            finally:
                _tidy(loop, directory)
        save()
        state = "finished"
    except BaseException as error:
        state = "stopped" if isinstance(error, Interrupted) else "broken"
        # What ended the run is told, and not that a full disk has no room for this either:
        # manifest.jsonl has it all.
        with suppress(FactoryError):
            save()
        raise
    finally:
        progress.close(state)
    made = loop.manifest
    return RunReport(
        samples=made.samples(),
        samples_by_split={split: made.samples(split) for split in SPLITS},
        shards=len(made.shards),
        bytes=made.total_bytes(),
        kept=len(tasks) - len(todo) + loop.kept,
        failures=tuple(
            failure for path in sorted(loop.failures) for failure in loop.failures[path]
        ),
        seconds=time.monotonic() - started,
    )
