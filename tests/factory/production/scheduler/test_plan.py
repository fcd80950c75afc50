"""The plan of shards, the numbers of workers, and `ulimit`: as many workers as fit."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from simnfnd.factory.common.command_line import guard
from simnfnd.factory.common.workers.settings import (
    MAX_AUTO_WORKERS,
    SchedulerSettings,
    WorkerCounts,
)
from simnfnd.factory.production.scheduler.plan import plan_shards
from tests.fake_source import refs
from tests.project_files import ROOT


@given(
    train=st.integers(0, 60),
    test=st.integers(0, 20),
    variants=st.integers(1, 5),
    shard_size=st.integers(1, 12),
    limit=st.none() | st.integers(0, 100),
)
def test_plan_holds_every_sample_once_in_order(
    train: int, test: int, variants: int, shard_size: int, limit: int | None
) -> None:
    frames = {"train": refs(train), "test": refs(test, "beta")}
    tasks = plan_shards(frames, variants, shard_size, {"train": limit})
    assert tasks == plan_shards(frames, variants, shard_size, {"train": limit})
    for split, count in (("train", train), ("test", test)):
        own = [task for task in tasks if task.split == split]
        assert [task.path for task in own] == [
            f"{split}/shard-{index:05d}.h5" for index in range(len(own))
        ]
        samples = [
            (ref.frame, variant)
            for task in own
            for ref, numbers in task.items
            for variant in numbers
        ]
        whole = count * variants
        limited = whole if limit is None or split == "test" else min(limit, whole)
        assert len(samples) == limited == sum(task.samples for task in own)
        assert samples == sorted(set(samples))
        assert all(0 < task.samples <= shard_size for task in own)
        if variants <= shard_size:
            homes = [ref.frame for task in own for ref, _ in task.items]
            assert len(homes) == len(set(homes)), "a frame lies in two shards"


def test_a_limit_takes_frames_from_all_scenes() -> None:
    frames = refs(50, "alpha") + refs(50, "beta")
    (task,) = plan_shards({"train": frames}, 1, 100, {"train": 10})
    scenes = [ref.scene for ref, _ in task.items]
    assert scenes.count("alpha") == scenes.count("beta") == 5


def test_crew_follows_cores_memory_and_work(monkeypatch: pytest.MonkeyPatch) -> None:
    from simnfnd.factory.common.workers import settings as module

    def machine(cores: int, memory_gb: float) -> None:
        monkeypatch.setattr(module, "usable_cores", lambda: cores)
        monkeypatch.setattr(module, "available_memory_bytes", lambda: int(memory_gb * 1e9))

    auto = SchedulerSettings()
    machine(64, 100)
    assert auto.worker_counts(1000, 0) == WorkerCounts(0, MAX_AUTO_WORKERS)
    assert MAX_AUTO_WORKERS == 48
    assert auto.worker_counts(5, 0) == WorkerCounts(0, 5)
    assert auto.worker_counts(1000, 9000) == WorkerCounts(48, 0), "room for 48 that render"
    machine(64, 30)
    worker_counts = auto.worker_counts(1000, 9000)
    assert worker_counts.total == 48
    assert 0.3 * worker_counts.noise + 1.0 * worker_counts.render < 30 * 0.8
    machine(2, 24)
    assert auto.worker_counts(1000, 9000) == WorkerCounts(2, 0)
    assert SchedulerSettings(workers=48).worker_counts(4, 16) == WorkerCounts(2, 14)
    assert SchedulerSettings(workers=48, render_workers=5).worker_counts(100, 99) == WorkerCounts(
        5, 43
    )
    machine(8, 0)
    assert auto.worker_counts(1000, 9000) == WorkerCounts(1, 0)
    assert auto.worker_counts(1000, 0) == WorkerCounts(0, 1)
    assert SchedulerSettings(workers=7).worker_counts(1000, 0) == WorkerCounts(0, 7)


CODE = """
import resource, sys
from pathlib import Path
from simnfnd.factory.common.command_line import guard
from tests.run_fake import make
if __name__ == "__main__":
    limit, folder = int(sys.argv[1]), Path(sys.argv[2])
    resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))
    print(guard(lambda: print(make(folder, workers=48).samples)))
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("limit", "said", "told"),
    [
        (64, r"ulimit -n is 64: [12] of 4 workers fit and are used; raise it", "32\n0\n"),
        (40, r"error: scheduler.workers: ulimit -n is 40, in which no worker fits", "2\n"),
    ],
)
def test_a_shell_with_few_open_files(tmp_path: Path, limit: int, said: str, told: str) -> None:
    script = tmp_path / "run.py"
    script.write_text(CODE)
    done = subprocess.run(
        [sys.executable, str(script), str(limit), str(tmp_path / "dataset")],
        cwd=ROOT, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    assert re.search(said, done.stderr)
    assert "Traceback" not in done.stderr
    assert done.stdout == told


def test_the_papers_48_processes_in_a_narrow_shell(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import resource

    monkeypatch.setattr(resource, "getrlimit", lambda kind: (256, 256))
    values = yaml.safe_load((ROOT / "conf/scheduler/paper48.yaml").read_text())
    del values["defaults"]
    actual = SchedulerSettings(**values).worker_counts(480, 480)
    assert 4 < actual.total < 40
    assert capsys.readouterr().err.startswith(
        f"ulimit -n is 256: {actual.total} of 48 workers fit and are used; raise it"
    )


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (PermissionError(13, "Permission denied", "a/train"), "error: a/train: Permission denied"),
        (OSError(24, "Too many open files"), "error: system: Too many open files; raise"),
        (OSError(40, "Too many levels of symbolic links", "a"), "error: a: Too many levels"),
        (MemoryError(), "error: memory: not enough of it"),
    ],
)
def test_what_the_machine_refuses_is_one_line(
    error: BaseException, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def action() -> None:
        raise error

    assert guard(action) == 2
    message = capsys.readouterr().err
    assert message.startswith(said)
    assert message.count("\n") == 1
    with pytest.raises(type(error)):
        guard(action, debug=True)
