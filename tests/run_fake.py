"""`python -m tests.run_fake DIR WORKERS DELAY_S`: a run that a test can interrupt or kill."""

from __future__ import annotations

import sys
from pathlib import Path

from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.jobs.generate import generate_dataset
from simnfnd.factory.jobs.plan import plan_shards
from simnfnd.factory.jobs.run import RunReport
from simnfnd.factory.jobs.settings import SchedulerSettings
from simnfnd.factory.workers.signals import Interrupted
from tests.fake_source import FakeConfig, FakeSource, refs, rerun

IDENTITY = {"seed": 0, "noise": {"background": {"density": {"uniform": [0.1, 0.5]}}}}


def make(directory: Path, config: FakeConfig = FakeConfig(), **changes: object) -> RunReport:  # noqa: B008
    """A dataset of 12 train and 4 test frames, two variants each, in shards of 8 samples."""
    given: dict[str, object] = {
        "source": FakeSource,
        "identity": IDENTITY,
        "config_hash": "c0ffee0123456789",
        "dataset": DatasetSettings(preview_pairs=0),
        "workers": 2,
        "retries": 1,
        "frame_timeout_s": 60.0,
        "recycle_frames": 200,
        **changes,
    }
    scheduler = SchedulerSettings(
        workers=given.pop("workers"),  # type: ignore[arg-type]
        retries=given.pop("retries"),  # type: ignore[arg-type]
        frame_timeout_s=given.pop("frame_timeout_s"),  # type: ignore[arg-type]
        recycle_frames=given.pop("recycle_frames"),  # type: ignore[arg-type]
        shard_size=8,
        backoff_s=0.05,
        **given.pop("scheduler", {}),
    )
    frames = {"train": refs(12), "test": refs(4, "beta")}
    return generate_dataset(
        directory,
        plan_shards(frames, variants=2, shard_size=8),
        config=config,
        config_dict={**IDENTITY, "scheduler": {"workers": scheduler.workers}},
        scheduler=scheduler,
        skipped={"no depth": 3},
        rerun_command=rerun,
        **given,  # type: ignore[arg-type]
    )


if __name__ == "__main__":
    folder, workers, delay_s = sys.argv[1:]
    try:
        make(Path(folder), FakeConfig(delay_s=float(delay_s)), workers=int(workers))
    except Interrupted as error:
        sys.exit(error.exit_code)
