"""`python -m tests.run_fake DIR WORKERS DELAY_S`: a run that a test can interrupt or kill."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from simnfnd.factory.common.signals import Interrupted
from simnfnd.factory.common.workers.settings import SchedulerSettings
from simnfnd.factory.dataset.schema import Provenance, config_hash
from simnfnd.factory.dataset.settings import DatasetSettings
from simnfnd.factory.production.scheduler.plan import DatasetJob, plan_shards
from simnfnd.factory.production.scheduler.results import RunReport
from simnfnd.factory.production.scheduler.run import make_dataset
from tests.fake_source import FakeConfig, FakeSource, refs, rerun

IDENTITY = {"seed": 0, "noise": {"background": {"density": {"uniform": [0.1, 0.5]}}}}


def make(directory: Path, *arguments: Any, **changes: Any) -> RunReport:
    """`job` made."""
    return make_dataset(job(directory, *arguments, **changes))


def job(
    directory: Path,
    config: FakeConfig = FakeConfig(),  # noqa: B008
    *,
    identity: dict[str, Any] = IDENTITY,
    workers: int = 2,
    retries: int = 1,
    frame_timeout_s: float = 60.0,
    recycle_frames: int = 200,
    scheduler: dict[str, Any] | None = None,
    **changes: Any,
) -> DatasetJob:
    """A dataset of 12 train and 4 test frames, two variants each, in shards of 8 samples.

    changes: fields of `DatasetJob`.
    """
    settings = SchedulerSettings(
        workers=workers,
        retries=retries,
        frame_timeout_s=frame_timeout_s,
        recycle_frames=recycle_frames,
        shard_size=8,
        **(scheduler or {}),
    )
    frames = {"train": refs(12), "test": refs(4, "beta")}
    fields: dict[str, Any] = {
        "directory": directory,
        "tasks": plan_shards(frames, variants=2, shard_size=8),
        "source": FakeSource,
        "config": config,
        "provenance": Provenance(identity, config_hash(identity), "simnfnd test"),
        "config_values": {**identity, "scheduler": {"workers": workers}},
        "dataset": DatasetSettings(preview_pairs=0),
        "scheduler": settings,
        "rerun_command": rerun,
        "skipped": {"no depth": 3},
        **changes,
    }
    return DatasetJob(**fields)


if __name__ == "__main__":
    folder, workers, delay_s = sys.argv[1:]
    try:
        make(Path(folder), FakeConfig(delay_s=float(delay_s)), workers=int(workers))
    except Interrupted as error:
        sys.exit(error.exit_code)
