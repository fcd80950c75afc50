"""From a plan to a finished dataset folder: shards, manifest, failures, preview, descriptions."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from tqdm import tqdm

from simnfnd.factory import __version__
from simnfnd.factory.dataset.describe.card import write_card
from simnfnd.factory.dataset.describe.croissant import write_croissant
from simnfnd.factory.dataset.describe.preview import preview
from simnfnd.factory.dataset.format.manifest import load_manifest
from simnfnd.factory.dataset.format.sample import PairSource, Preparer
from simnfnd.factory.dataset.format.schema import Provenance
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.folder import WORK_NAME, empty_folder, forget_slices, open_folder
from simnfnd.factory.dataset.write.index import write_index
from simnfnd.factory.dataset.write.writer import compression_filter
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.jobs.earlier import earlier_shards, provenances
from simnfnd.factory.jobs.extend import Plan, begin_extension
from simnfnd.factory.jobs.lock import Lock
from simnfnd.factory.jobs.plan import ShardTask
from simnfnd.factory.jobs.run import RunReport, run
from simnfnd.factory.jobs.settings import SchedulerSettings, ShardSlice
from simnfnd.factory.jobs.worker import Recipe
from simnfnd.factory.workers.signals import stop_signals

_NO_SLICES = {
    "overwrite": "dataset.on_existing=overwrite: slices would delete each other's shards; "
    "empty the folder first",
    "extend": "dataset.on_existing=extend: a dataset is extended as a whole; run it without "
    "shard.index and shard.count, or make the addition elsewhere and merge",
}


def generate_dataset(
    directory: Path,
    tasks: Sequence[ShardTask],
    *,
    source: Callable[[Any], PairSource],
    config: Any,
    config_dict: Mapping[str, Any],
    identity: Mapping[str, Any],
    config_hash: str,
    dataset: DatasetSettings,
    scheduler: SchedulerSettings,
    skipped: Mapping[str, int],
    rerun_command: Callable[[FrameRef], str],
    preparer: Callable[[Any], Preparer] | None = None,
    shard: ShardSlice = ShardSlice(),  # noqa: B008 (frozen)
    keep_cache_within: Callable[[int], None] = lambda added_bytes: None,
    extended: Plan | None = None,
) -> RunReport:
    """Make the dataset `directory`, or finish it; running the same again keeps what is whole.

    source, config: `source(config)` builds the pair source in each worker; both must pickle, and
        `source` must be importable.
    config_dict: the whole configuration as plain values; written to config.yaml.
    identity: the part of it that decides the bytes of the samples and that `config_hash` stands
        for; written into every shard, so it must not tell the number of workers or a folder.
    skipped: reason -> images left out before planning; told in the card.
    rerun_command: frame -> the command line that tries it again; told in failed.jsonl.
    preparer: likewise builds what prepares frames for `source` in the workers that render.
    shard: which slice of the shards to make; the run of the whole, made last, takes them up.
    keep_cache_within: told how many bytes were added whenever a frame was prepared.
    extended: plans the shards of a dataset that extends an earlier one, in place of `tasks`.

    Raises FactoryError when the folder is another dataset's, cannot be written, or nothing was
    planned; Interrupted (a KeyboardInterrupt with `exit_code`) on Ctrl-C and SIGTERM.
    """
    if not tasks:
        raise FactoryError("nothing to make: no frame was chosen, or max_train and max_test are 0")
    compression_filter(dataset)
    provenance = Provenance(identity, config_hash, f"simnfnd {__version__}")
    part = f"{shard.index}-of-{shard.count}" if shard.count > 1 else ""
    if part and dataset.on_existing != "resume":
        raise FactoryError(_NO_SLICES[dataset.on_existing])
    with stop_signals(), Lock(directory, part) as lock:
        emptied = dataset.on_existing == "overwrite" and empty_folder(directory)
        if dataset.on_existing == "extend" and extended:
            for note in begin_extension(directory, provenance, extended):
                tqdm.write(note, file=sys.stderr)
        manifest = open_folder(directory, config_dict, provenance, part, emptied=emptied)
        earlier = earlier_shards(directory, manifest)
        if earlier:
            if extended is None or part:
                raise FactoryError(_NO_SLICES["extend"])
            tasks = extended(earlier)
        recipe = Recipe(
            Path(os.path.abspath(directory)),
            source,
            config,
            provenance,
            dataset,
            scheduler.frame_timeout_s,
            preparer,
            work_name(shard),
        )
        mine = tasks[shard.index :: shard.count]
        report = run(
            mine,
            recipe,
            manifest,
            scheduler,
            rerun_command,
            lock,
            part,
            keep_cache_within,
            provenances(manifest, earlier),
        )
        if not part:
            forget_slices(directory)
            _describe(directory, provenance, dataset, report, skipped)
    return report


def work_name(shard: ShardSlice) -> str:
    """Name of the folder for what a run needs while it lasts."""
    return f"{WORK_NAME}-{shard.index}-of-{shard.count}" if shard.count > 1 else WORK_NAME


def _describe(
    directory: Path,
    provenance: Provenance,
    dataset: DatasetSettings,
    report: RunReport,
    skipped: Mapping[str, int],
) -> None:
    """All that stands beside the shards."""
    finished = load_manifest(directory)
    if finished is not None and report.samples:
        write_index(directory, finished)
        if dataset.preview_pairs:
            preview(directory, pairs=dataset.preview_pairs, trusted=True)
        write_card(directory, finished, provenance, dataset, report.failures, skipped)
        write_croissant(directory, finished, dataset)
