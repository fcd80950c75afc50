"""Workers that stand still, and a template that is stopped or killed: time alone is lost."""

from __future__ import annotations

import os
import signal
import time
from multiprocessing import forkserver
from pathlib import Path
from typing import Any

import psutil
import pytest

from simnfnd.factory.scheduler.workers import template
from simnfnd.factory.scheduler.workers.contract import Pool, WorkerSettings
from simnfnd.factory.scheduler.workers.local import LocalBackend
from tests.factory.scheduler.run_files import wait_for
from tests.fake_source import FakeConfig
from tests.run_fake import make

FORKED = WorkerSettings((Pool("all", 2),), preload=("simnfnd.factory.scheduler.worker",))


def template_pid() -> int:
    server: Any = vars(forkserver)["_forkserver"]
    return int(server._forkserver_pid)


def nap(seconds: float) -> int:
    time.sleep(seconds)
    return os.getpid()


def test_a_stopped_worker_costs_the_limit_and_some_seconds(tmp_path: Path) -> None:
    config = FakeConfig(stops=("reef/alpha/0002",))
    make(tmp_path / "first", workers=2)  # the template is warm
    begun = time.monotonic()
    report = make(tmp_path / "dataset", config, workers=2, retries=0, frame_timeout_s=1.0)
    assert time.monotonic() - begun < 1 + 12, "the rest of the run on a busy machine"
    (failure,) = report.failures
    assert (report.samples, failure.ref.name, failure.kind) == (30, "reef/alpha/0002", "timeout")
    assert "frame_timeout_s=1" in failure.reason


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_workers_outlive_their_template_and_not_the_backend(number: int) -> None:
    template.kill()
    backend = LocalBackend(FORKED)
    pids = []
    try:
        futures = [backend.submit(nap, 0.0, 60.0, "all") for _ in range(2)]
        pids = [future.result(60) for future in futures]
        again = [backend.submit(nap, 0.7, 60.0, "all") for _ in range(2)]
        os.kill(template_pid(), number)
        assert {future.result(60) for future in again} == set(pids), "one was taken for dead"
        backend.submit(nap, 60.0, 90.0, "all")
    finally:
        backend.stop()
        template.kill()
    wait_for(lambda: not any(map(_alive, pids)), 10)


def _alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
