"""What is to be made: which shard holds which frames, and how it is made.

The shards are decided before the work, by the frames and the settings alone.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...common.errors import FactoryError
from ...common.files import write_atomically
from ...common.progress import RunReporter
from ...common.small_files import open_regular, parse_json, read_regular
from ...common.workers.settings import SchedulerSettings, ShardSlice
from ...dataset.folder import WORK_NAME
from ...dataset.frame_ref import FrameRef
from ...dataset.schema import SPLITS, PairSource, Preparer, Provenance
from ...dataset.settings import DatasetSettings

if TYPE_CHECKING:
    from .lock import Publication

FrameVariants = tuple[FrameRef, tuple[int, ...]]


@dataclass(frozen=True)
class ShardTask:
    """One shard to make; small enough to be sent to any worker.

    path: below the dataset's folder.
    items: (frame, variants of it to make), in the order of the samples.
    inputs: hash of the content of its frames' files; empty: of what the configuration decides.
    """

    split: str
    path: str
    items: tuple[FrameVariants, ...]
    inputs: str = ""

    @cached_property
    def samples(self) -> int:
        """How many samples the shard has when no frame fails."""
        return sum(len(variants) for _, variants in self.items)

    @cached_property
    def digest(self) -> str:
        """Hash of the frames and variants that the shard holds, wherever their files are."""
        content = [(ref.location, ref.scene, ref.frame, variants) for ref, variants in self.items]
        return hashlib.sha256(json.dumps(content).encode()).hexdigest()[:16]


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """How every shard of a dataset is made; sent to the workers with each task.

    source: builds the pair source from `config`; an importable function or class, because each
        worker process calls it for itself.
    preparer: likewise builds what prepares the frames, in the workers that render; None when
        nothing is to be prepared.
    provenance: what every shard states, so it must not depend on workers or folders.
    publication: where the dataset goes when its folder is the copy of a URL.
    """

    directory: Path
    source: Callable[[Any], PairSource]
    preparer: Callable[[Any], Preparer] | None = None
    config: Any
    provenance: Provenance
    dataset: DatasetSettings
    publication: Publication | None = None

    @property
    def prepares(self) -> bool:
        """Whether frames are prepared for all; workers that share no folder share no renders."""
        return self.preparer is not None and not (self.publication and self.publication.is_remote)


@dataclass(frozen=True, kw_only=True)
class DatasetJob(Recipe):
    """The dataset in `directory`: what it is made of, how, and by which workers.

    tasks: all shards of the dataset, also where only a slice of them is to be made.
    config_values: the whole configuration as plain values; written to config.yaml.
    rerun_command: frame -> the command line that tries it again; written to failed.jsonl.
    skipped: reason -> images left out before planning; stated in the card.
    facts: what the card states of the finished dataset in a folder and how it was made.
    shard: which slice of the shards to make; the run of the whole, made last, takes them up.
    on_prepared: called with the bytes added to the cache whenever a frame was prepared.
    warnings: lines for the user, printed when planning and again at the end.
    preload: modules that every worker needs, loaded once for all.
    reporter: told what the run does.
    """

    tasks: tuple[ShardTask, ...]
    config_values: Mapping[str, Any]
    scheduler: SchedulerSettings
    rerun_command: Callable[[FrameRef], str]
    skipped: Mapping[str, int] = field(default_factory=dict)
    facts: Callable[[Path], Sequence[str]] = lambda directory: ()
    shard: ShardSlice = field(default_factory=ShardSlice)
    on_prepared: Callable[[int], None] = lambda added_bytes: None
    warnings: tuple[str, ...] = ()
    preload: tuple[str, ...] = ("simnfnd.factory.production.scheduler.worker",)
    reporter: RunReporter = field(default_factory=RunReporter)

    @property
    def own_tasks(self) -> tuple[ShardTask, ...]:
        """The shards that this run makes."""
        return self.tasks[self.shard.index :: self.shard.count]

    @property
    def recipe(self) -> Recipe:
        """The part that workers need, wherever they run."""
        values = {field.name: getattr(self, field.name) for field in fields(Recipe)}
        return Recipe(**{**values, "directory": Path(os.path.abspath(self.directory))})


class InputDigests:
    """SHA-256 digests of files; a file is read again when its size, times or inode differ.

    The time of change counts, too: tools may set the time of modification, but not this one.
    """

    def __init__(self, table_path: Path | None) -> None:
        """table_path: where they are kept; None keeps none.  A damaged table counts for nothing."""
        self._table_path = table_path
        self._stored: dict[str, str] = {}
        self._used: dict[str, str] = {}
        if table_path is not None:
            with suppress(OSError, ValueError, TypeError):
                self._stored = dict(parse_json(read_regular(table_path)))

    def digest(self, path: str) -> str:
        """32 hexadecimal digits of a file's content; empty for a file that cannot be read."""
        with suppress(OSError), open_regular(Path(path)) as file:
            status = os.fstat(file.fileno())
            times = f"{status.st_mtime_ns} {status.st_ctime_ns}"
            state = f"{os.path.abspath(path)} {status.st_size} {times} {status.st_ino}"
            digest = self._stored.get(state)
            if digest is None:
                digest = hashlib.file_digest(file, "sha256").hexdigest()[:32]  # type: ignore[arg-type]
            self._used[state] = digest
            return digest
        return ""

    def save(self) -> None:
        """Keep those of this run, where the folder can be written."""
        if self._table_path is None or self._used == self._stored:
            return
        text = json.dumps(self._used, separators=(",", ":"))
        with suppress(FactoryError):
            write_atomically(self._table_path, text.encode(), durable=False)


def with_inputs(
    tasks: Sequence[ShardTask], table_path: Path | None = None
) -> tuple[ShardTask, ...]:
    """The tasks with the hashes of their frames' files, wherever these lie.

    table_path: where hashes are kept for later runs; None: each file is read.
    """
    inputs = InputDigests(table_path)
    with ThreadPoolExecutor() as pool:
        hashed = tuple(pool.map(lambda task: _with_inputs(task, inputs), tasks))
    inputs.save()
    return hashed


def _with_inputs(task: ShardTask, inputs: InputDigests) -> ShardTask:
    digests = [[inputs.digest(path) for path in ref.paths] for ref, _ in task.items]
    return replace(task, inputs=hashlib.sha256(json.dumps(digests).encode()).hexdigest()[:16])


def work_folder(directory: Path, shard: ShardSlice) -> Path:
    """The folder of a run's own files, removed at its end."""
    return directory / (f"{WORK_NAME}-{shard.part}" if shard.part else WORK_NAME)


def plan_shards(
    refs_by_split: Mapping[str, Sequence[FrameRef]],
    variants: int,
    shard_size: int,
    limits: Mapping[str, int | None] | None = None,
) -> tuple[ShardTask, ...]:
    """Cut the frames of each split into shards of at most `shard_size` samples.

    refs_by_split: "train" and "test" -> frames, in the order in which they are to lie.
    variants: samples per frame.
    limits: split -> upper limit on samples.  When it bites, frames are taken evenly from the
        whole list, so that no scene is left out; the last one taken may give fewer variants.

    The variants of a frame lie in one shard, unless a frame has more of them than a shard holds:
    then the frame fills shards of its own.
    """
    tasks: list[ShardTask] = []
    for split in SPLITS:
        refs = refs_by_split.get(split, ())
        limit = (limits or {}).get(split)
        samples = len(refs) * variants
        samples = samples if limit is None else min(limit, samples)
        frame_count = -(-samples // variants)  # rounded up
        chosen = [refs[k * len(refs) // frame_count] for k in range(frame_count)]
        items = [(ref, tuple(range(variants))) for ref in chosen]
        if samples % variants:
            items[-1] = chosen[-1], tuple(range(samples % variants))
        shards: list[tuple[FrameVariants, ...]]
        if variants > shard_size:
            shards = [
                ((ref, numbers[start : start + shard_size]),)
                for ref, numbers in items
                for start in range(0, len(numbers), shard_size)
            ]
        else:
            step = shard_size // variants
            shards = [tuple(items[k : k + step]) for k in range(0, len(items), step)]
        tasks += [
            ShardTask(split, f"{split}/shard-{number:05d}.h5", shard)
            for number, shard in enumerate(shards)
        ]
    return tuple(tasks)
