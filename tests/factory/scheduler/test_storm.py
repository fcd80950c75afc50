"""A storm over a run: its workers are killed at random, the run itself once."""

from __future__ import annotations

import random
import subprocess
import sys
import time
from pathlib import Path

import pytest

from simnfnd.factory.dataset.manifest import load_failures
from tests.factory.scheduler.run_files import shard_bytes
from tests.factory.scheduler.staged import staged
from tests.fake_source import FakeConfig
from tests.project_files import ROOT
from tests.worker_processes import workers_of

KILLS, HANGS = "reef/alpha/0004", "reef/alpha/0009"
WORKER_KILLS, MOST_RUNS = 6, 12

RUN = """
import sys
from pathlib import Path
from tests.factory.scheduler.staged import staged
from tests.factory.scheduler.test_storm import HANGS, KILLS
from tests.fake_source import FakeConfig
config = FakeConfig(kills=(KILLS,), hangs=(HANGS,), delay_s=0.1)
how = {"scheduler": {"render_workers": 3}, "workers": 5, "retries": 2, "frame_timeout_s": 1.5}
staged(Path(sys.argv[1]), config, **how)
"""


@pytest.mark.slow
def test_killing_workers_and_the_run_costs_the_bad_frames_alone(tmp_path: Path) -> None:
    calm, directory = tmp_path / "calm" / "dataset", tmp_path / "storm" / "dataset"
    staged(calm, FakeConfig(bad=(KILLS, HANGS)), scheduler={"backend": "serial"})
    directory.parent.mkdir()
    chance = random.Random(0)
    kills, run_killed, missing = 0, False, {"not begun"}
    for _ in range(MOST_RUNS):
        command = [sys.executable, "-c", RUN, str(directory)]
        run = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.DEVNULL, start_new_session=True)
        while run.poll() is None:
            time.sleep(chance.uniform(0.2, 0.7))
            workers = workers_of(run.pid)
            if kills < WORKER_KILLS and workers and run.poll() is None:
                chance.choice(workers).kill()
                kills += 1
            if kills > WORKER_KILLS // 2 and not run_killed:
                run.kill()
                run_killed = True
        run.wait()
        missing = {item["frame"] for item in load_failures(directory)}
        if run.returncode == 0 and missing == {KILLS, HANGS}:
            break
    assert missing == {KILLS, HANGS}
    assert (kills, run_killed) == (WORKER_KILLS, True)
    assert shard_bytes(directory) == shard_bytes(calm)
