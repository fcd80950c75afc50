"""A short storm over a run; `python -m benchmarks storm` is the long one."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.storm import HANGS, KILLS, storm, undisturbed


@pytest.mark.slow
def test_killing_workers_and_the_run_costs_the_bad_frames_alone(tmp_path: Path) -> None:
    expected = undisturbed(tmp_path / "calm" / "dataset", 8)
    directory = tmp_path / "storm" / "dataset"
    done = storm(directory, "local", shards=8, kills=6, run_kills=1, delay_s=0.1)
    assert (done.worker_kills, done.run_kills) == (6, 1)
    assert done.named == (KILLS, HANGS)
    assert done.shards == expected
