"""What an earlier run left that this one need not make again."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

from ..dataset.format.manifest import Manifest, damage
from ..dataset.format.schema import SPLITS
from ..errors import FactoryError
from ..files import explain_os_errors, names_outside, remove_file
from ..ownership import check_fences
from .plan import ShardTask

_SHARD_NAME = re.compile(r"shard-\d{5,}\.h5")


@dataclass(frozen=True)
class Resumed:
    """Where a run starts.

    manifest: the shards that are whole and planned the same.
    todo: tasks to make, or to try again because they lack frames.
    lacking: path of such a shard -> names of the frames it lacks.
    notes: one line about each shard that was found damaged.
    """

    manifest: Manifest
    todo: tuple[ShardTask, ...]
    lacking: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...]


def take_up(
    directory: Path, tasks: Sequence[ShardTask], manifest: Manifest, *, whole: bool = True
) -> Resumed:
    """Compare plan, manifest and disk; shards that the plan no longer has are removed.

    whole: `tasks` are all of the dataset; of a slice nothing is removed.

    Raises FactoryError when the plan has fewer samples than the folder already holds: then frames
    have gone missing since, and going on would throw finished work away.
    """
    _refuse_shrinking(directory, tasks, manifest)
    planned = {task.path: task for task in tasks}
    same = [
        info
        for path, info in manifest.shards.items()
        if path in planned and info.plan == planned[path].digest
    ]
    with ThreadPoolExecutor() as pool:
        found = list(pool.map(lambda info: damage(directory, info), same))
    good = {info.path: info for info, problem in zip(same, found, strict=True) if not problem}
    notes = tuple(
        f"{directory / info.path}: {problem}; it is made again"
        for info, problem in zip(same, found, strict=True)
        if problem
    )
    if whole:
        _remove_unplanned(directory, planned)
    kept = replace(manifest, shards=good)
    todo = tuple(
        task for task in tasks if task.path not in good or good[task.path].samples < task.samples
    )
    lacking = {task.path: good[task.path].failed for task in todo if task.path in good}
    return Resumed(kept, todo, lacking, notes)


def _refuse_shrinking(directory: Path, tasks: Sequence[ShardTask], manifest: Manifest) -> None:
    planned: Counter[str] = Counter()
    for task in tasks:
        planned[task.split] += task.samples
    for split in SPLITS:
        there = manifest.samples(split)
        if there > planned[split]:
            raise FactoryError(
                f"dataset.dir: {directory} holds {there} {split} samples, but the scenes now give "
                f"only {planned[split]}; bring the frames back, or give another folder"
            )


def _remove_unplanned(directory: Path, planned: Mapping[str, ShardTask]) -> None:
    """Shards of an earlier cut of the same frames would be read as part of the dataset."""
    check_fences(directory)
    for split in SPLITS:
        found = {path.name for path in (directory / split).glob("shard-*.h5")}
        found |= {name.rpartition("/")[2] for name in names_outside(directory, split)}
        for name in sorted(found):
            if _SHARD_NAME.fullmatch(name) and f"{split}/{name}" not in planned:
                with explain_os_errors(directory / split / name):
                    remove_file(directory / split / name)
