"""From a plan to a finished dataset folder: shards, manifest, failures, preview, card."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from factory import __version__
from factory.errors import FactoryError
from factory.frame import FrameRef
from factory.sample import PairSource
from factory.scheduler.plan import ShardTask
from factory.scheduler.run import RunReport, run
from factory.scheduler.settings import SchedulerSettings
from factory.scheduler.worker import Recipe
from factory.shards.card import write_card
from factory.shards.folder import open_folder
from factory.shards.manifest import load_manifest
from factory.shards.preview import preview
from factory.shards.schema import Provenance
from factory.shards.settings import DatasetSettings
from factory.shards.writer import compression_filter


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
) -> RunReport:
    """Make the dataset `directory`, or finish it; running the same again keeps what is whole.

    source, config: `source(config)` builds the pair source in each worker; both must pickle, and
        `source` must be importable.
    config_dict: the whole configuration as plain values; written to config.yaml.
    identity: the part of it that decides the bytes of the samples and that `config_hash` stands
        for; written into every shard, so it must not tell the number of workers or a folder.
    skipped: reason -> images left out before planning; told in the card.
    rerun_command: frame -> the command line that tries it again; told in failed.jsonl.

    Raises FactoryError when the folder is another dataset's, cannot be written, or nothing was
    planned; Interrupted (a KeyboardInterrupt with `exit_code`) on Ctrl-C and SIGTERM.
    """
    if not tasks:
        raise FactoryError("nothing to make: no frame was chosen, or max_train and max_test are 0")
    compression_filter(dataset)
    provenance = Provenance(identity, config_hash, f"simnfnd {__version__}")
    manifest = open_folder(directory, config_dict, provenance)
    recipe = Recipe(directory, source, config, provenance, dataset, scheduler.frame_timeout_s)
    report = run(tasks, recipe, manifest, scheduler, rerun_command)
    finished = load_manifest(directory)
    if finished is not None and report.samples:
        if dataset.preview_pairs:
            preview(directory, pairs=dataset.preview_pairs)
        write_card(directory, finished, provenance, dataset, report.failures, skipped)
    return report
