"""Worker processes by themselves: pools, tasks that die or take too long, what they import."""

from __future__ import annotations

import os
import signal
import time
from collections import deque

import psutil
import pytest

from simnfnd.factory.scheduler.workers import local, workers_of
from simnfnd.factory.scheduler.workers.contract import Pool, WorkerSettings
from simnfnd.factory.scheduler.workers.local import LocalBackend, WorkerDied
from simnfnd.factory.scheduler.workers.tasks import TaskLost, TaskPool
from tests.worker_processes import workers_of as processes_of

HEAVY, LIGHT = Pool("heavy", 1, also_takes=("light",)), Pool("light", 1)


def task(name: str) -> tuple[str, int]:
    """(name, process number), unless the name says to fail, die or sleep."""
    if name == "fail":
        raise ZeroDivisionError(name)
    if name == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if name == "sleep":
        time.sleep(60)
    return name, os.getpid()


def children() -> list[psutil.Process]:
    return processes_of(os.getpid())


def test_a_task_that_dies_or_sleeps_costs_itself_alone() -> None:
    names = ["a", "die", "b", "sleep", "c"]
    with TaskPool(2) as pool:
        found = dict(pool.run(task, deque(names), lambda name: 1.0 if name == "sleep" else 60.0))
    assert set(found) == set(names)
    for name in "abc":
        outcome = found[name]
        assert not isinstance(outcome, TaskLost)
        assert outcome[0] == name
        assert outcome[1] != os.getpid()
    died, slept = found["die"], found["sleep"]
    assert isinstance(died, TaskLost)
    assert "SIGKILL" in died.reason
    assert slept == TaskLost("took longer than 1 s")
    assert not children()


def test_a_worker_that_is_stopped_before_it_has_its_task_is_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(local, "_BEGIN_S", 2.0)
    workers = LocalBackend(WorkerSettings((LIGHT,)))
    try:
        assert workers.submit(task, "a", 60.0, "light").result(60)[0] == "a"
        (process,) = children()
        process.suspend()
        # Larger than the buffer between the two: sending it waits for the stopped process.
        with pytest.raises(WorkerDied, match="stood still before it had begun"):
            workers.submit(len, bytes(1 << 24), 60.0, "light").result(30)
        assert workers.submit(len, bytes(1 << 24), 60.0, "light").result(60) == 1 << 24
        (other,) = children()
        assert other.pid != process.pid
    finally:
        workers.stop()
    assert not children()


def test_a_worker_that_dies_idle_or_cannot_send_its_answer_is_no_end() -> None:
    workers = LocalBackend(WorkerSettings((LIGHT,)))
    try:
        _, pid = workers.submit(task, "a", 60.0, "light").result(60)
        os.kill(pid, signal.SIGKILL)
        died = "no"
        try:
            _, pid = workers.submit(task, "b", 60.0, "light").result(60)
        except WorkerDied as error:  # found out only when it is asked
            died = str(error)
        assert died == "no" or "SIGKILL" in died
        with pytest.raises(TypeError, match="cannot pickle"):
            workers.submit(open, os.devnull, 60.0, "light").result(60)
        assert workers.submit(task, "c", 60.0, "light").result(60)[0] == "c"
    finally:
        workers.stop()


def test_a_pool_that_takes_others_tasks_prefers_its_own() -> None:
    with workers_of(WorkerSettings((HEAVY, LIGHT))) as workers:
        first = workers.submit(task, "a", 60.0, "heavy")
        assert not workers.free("heavy")
        assert workers.free("light")
        second = workers.submit(task, "b", 60.0, "light")
        (_, heavy), (_, light) = first.result(60), second.result(60)
        assert heavy != light
        assert workers.submit(task, "c", 60.0, "heavy").result(60) == ("c", heavy)
