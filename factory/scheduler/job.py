"""One dataset to make: all that a run has to know, in one frozen object."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..dataset.folder import WORK_NAME
from ..dataset.schema import PairSource, Preparer, Provenance
from ..dataset.settings import DatasetSettings
from ..frame import FrameRef
from ..storage.publish import Publication
from .plan import ShardTask
from .settings import SchedulerSettings, ShardSlice


@dataclass(frozen=True)
class Recipe:
    """How every shard of a dataset is made; sent to the workers with each task.

    source: builds the pair source from `config`; an importable function or class, because each
        worker process calls it for itself.
    preparer: likewise builds what prepares the frames, in the workers that render; None when
        nothing is to be prepared.
    publication: where the dataset goes when its folder is the copy of a URL.
    """

    directory: Path
    source: Callable[[Any], PairSource]
    preparer: Callable[[Any], Preparer] | None
    config: Any
    provenance: Provenance
    dataset: DatasetSettings
    publication: Publication | None = None

    @property
    def apart(self) -> bool:
        """Whether workers see nothing of the folder, and make all that they need themselves."""
        return self.publication is not None and self.publication.apart


@dataclass(frozen=True)
class Job:
    """The dataset in `directory`: what it is made of, how, and by which workers.

    tasks: all shards of the dataset, also where only a slice of them is to be made.
    source, preparer, config: as in `Recipe`; they must pickle.
    provenance: what every shard states, so it must not depend on workers or folders.
    config_values: the whole configuration as plain values; written to config.yaml.
    rerun_command: frame -> the command line that tries it again; written to failed.jsonl.
    skipped: reason -> images left out before planning; stated in the card.
    shard: which slice of the shards to make; the run of the whole, made last, takes them up.
    on_prepared: called with the bytes added to the cache whenever a frame was prepared.
    warnings: what the user is told when planning, and once more at the end.
    preload: modules that every worker needs, loaded once for all.
    """

    directory: Path
    tasks: tuple[ShardTask, ...]
    source: Callable[[Any], PairSource]
    config: Any
    provenance: Provenance
    config_values: Mapping[str, Any]
    dataset: DatasetSettings
    scheduler: SchedulerSettings
    rerun_command: Callable[[FrameRef], str]
    preparer: Callable[[Any], Preparer] | None = None
    skipped: Mapping[str, int] = field(default_factory=dict)
    shard: ShardSlice = field(default_factory=ShardSlice)
    on_prepared: Callable[[int], None] = lambda added_bytes: None
    warnings: tuple[str, ...] = ()
    preload: tuple[str, ...] = ("simnfnd.factory.scheduler.worker",)

    @property
    def own_tasks(self) -> tuple[ShardTask, ...]:
        """The shards that this run makes."""
        return self.tasks[self.shard.index :: self.shard.count]

    @property
    def recipe(self) -> Recipe:
        """The part that workers need."""
        return Recipe(
            Path(os.path.abspath(self.directory)),
            self.source,
            self.preparer,
            self.config,
            self.provenance,
            self.dataset,
        )


def work_folder(directory: Path, shard: ShardSlice) -> Path:
    """The folder of a run's own files, gone at its end."""
    return directory / (f"{WORK_NAME}-{shard.part}" if shard.part else WORK_NAME)
