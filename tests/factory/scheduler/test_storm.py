"""A run that everything happens to: its workers are killed at random, the run itself now and then.

`python -m tests.factory.scheduler.test_storm DIR` is the run, with frames that cost nothing but
time, so that the storm is about the scheduler alone.
"""

from __future__ import annotations

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from simnfnd.factory.dataset.format.schema import Provenance, config_hash
from simnfnd.factory.dataset.format.settings import DatasetSettings
from simnfnd.factory.dataset.write.failures import load_failures
from simnfnd.factory.scheduler.job import Job
from simnfnd.factory.scheduler.plan import plan_shards
from simnfnd.factory.scheduler.run import make_dataset
from simnfnd.factory.scheduler.settings import SchedulerSettings
from tests.factory.scheduler.run_files import shard_bytes
from tests.fake_source import FakeConfig, FakePreparer, GentleSource, refs, rerun
from tests.project_files import ROOT
from tests.worker_processes import workers_of

KILLS = "reef/alpha/0004"
HANGS = "reef/alpha/0009"


def make(directory: Path, config: FakeConfig, backend: str = "local") -> None:
    """The run: eight shards, two kinds of workers."""
    make_dataset(
        Job(
            directory,
            plan_shards({"train": refs(8 * 3)}, variants=1, shard_size=3),
            source=GentleSource,
            preparer=FakePreparer,
            config=config,
            provenance=Provenance({"seed": 0}, config_hash({"seed": 0}), "simnfnd storm"),
            config_values={},
            dataset=DatasetSettings(preview_pairs=0),
            scheduler=SchedulerSettings(
                backend=backend,  # type: ignore[arg-type]
                workers=5,
                render_workers=3,
                retries=2,
                frame_timeout_s=1.5,
            ),
            rerun_command=rerun,
        )
    )


@pytest.mark.slow
def test_killing_workers_and_the_run_costs_the_bad_frames_alone(tmp_path: Path) -> None:
    """The command is given again and again, until only the bad frames are missing."""
    calm = FakeConfig(bad=(KILLS, HANGS), prepared=str(tmp_path / "calm-prepared"))
    make(tmp_path / "calm", calm, "serial")
    directory, chance = tmp_path / "storm", random.Random(0)
    worker_kills = killed_runs = 0
    for _ in range(12):
        process = subprocess.Popen(
            [sys.executable, "-m", __name__, str(directory)], cwd=ROOT, start_new_session=True
        )
        while process.poll() is None:
            time.sleep(chance.uniform(0.2, 0.7))
            workers = workers_of(process.pid)
            if worker_kills < 6 and workers and process.poll() is None:
                chance.choice(workers).kill()
                worker_kills += 1
            if killed_runs < 1 and worker_kills > 3:
                process.kill()
                killed_runs += 1
        missing = {item["frame"] for item in load_failures(directory)}
        if process.wait() == 0 and missing <= {KILLS, HANGS}:
            break
    assert missing == {KILLS, HANGS}
    assert (worker_kills, killed_runs) == (6, 1)
    assert shard_bytes(directory) == shard_bytes(tmp_path / "calm")


if __name__ == "__main__":
    place = Path(sys.argv[1])
    prepared = str(place.parent / "prepared")
    make(place, FakeConfig(kills=(KILLS,), hangs=(HANGS,), delay_s=0.1, prepared=prepared))
