"""Worker processes: pools, tasks that die or hang, and the template they are forked from."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from simnfnd.factory.common.private_apis import fork_server_pid
from simnfnd.factory.common.workers import Backend, Pool, Task, WorkerDied, local, template
from simnfnd.factory.common.workers.local import LocalBackend
from simnfnd.factory.common.workers.tasks import TaskLost, TaskPool
from tests.fake_source import FakeConfig
from tests.project_files import ROOT
from tests.run_fake import make
from tests.worker_processes import workers_of as processes_of

WORKER_MODULES = ("simnfnd.factory.production.scheduler.worker",)


def template_pid() -> int:
    process_id = fork_server_pid()
    assert process_id is not None
    return process_id


def submit(workers: Backend, function: Callable[[Any], Any], argument: Any, kind: str) -> Any:
    return workers.submit(Task(function, argument, kind, silence_s=60.0))


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


def samples_made(folder: Path) -> int:
    return make(folder, workers=2).samples


def test_a_worker_of_a_pool_may_start_workers(tmp_path: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply(samples_made, (tmp_path / "dataset",)) == 32


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_workers_outlive_their_template_and_not_the_backend(number: int) -> None:
    template.kill()
    backend = LocalBackend(
        (Pool(("all",), 2),), preload=("simnfnd.factory.production.scheduler.worker",)
    )
    workers = []
    try:
        futures = [submit(backend, nap, 0.0, "all") for _ in range(2)]
        workers = [psutil.Process(future.result(60)) for future in futures]
        again = [submit(backend, nap, 0.7, "all") for _ in range(2)]
        os.kill(template_pid(), number)
        pids = {worker.pid for worker in workers}
        assert {future.result(60) for future in again} == pids, "one was taken for dead"
        submit(backend, nap, 60.0, "all")
    finally:
        backend.close()
        template.kill()
    _, alive = psutil.wait_procs(workers, timeout=10)
    assert not alive


HEAVY = Pool(("heavy", "light"), 1)
LIGHT = Pool(("light",), 1)


def task(name: str) -> tuple[str, int]:
    """(name, process number), unless the name says to die or sleep."""
    if name == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if name == "sleep":
        time.sleep(60)
    return name, os.getpid()


def children() -> list[psutil.Process]:
    return processes_of(os.getpid())


@pytest.mark.slow
def test_a_task_that_dies_or_sleeps_costs_itself_alone() -> None:
    names = ["a", "die", "b", "sleep", "c"]
    with TaskPool(2) as pool:
        actual = dict(pool.run(task, deque(names), lambda name: 1.0 if name == "sleep" else 60.0))
    assert set(actual) == set(names)
    for name in "abc":
        outcome = actual[name]
        assert not isinstance(outcome, TaskLost)
        assert outcome[0] == name
        assert outcome[1] != os.getpid()
    died = actual["die"]
    slept = actual["sleep"]
    assert isinstance(died, TaskLost)
    assert "SIGKILL" in died.reason
    assert slept == TaskLost("took longer than 1 s")
    assert not children()


@pytest.mark.slow
def test_a_worker_that_is_stopped_before_it_has_its_task_is_replaced(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(local, "_BEGIN_S", 2.0)
    workers = LocalBackend((LIGHT,))
    try:
        assert submit(workers, task, "a", "light").result(60)[0] == "a"
        (process,) = children()
        process.suspend()
        # Larger than the buffer between the two: sending it waits for the stopped process.
        with pytest.raises(WorkerDied, match="before it had begun"):
            submit(workers, len, bytes(1 << 24), "light").result(30)
        assert submit(workers, len, bytes(1 << 24), "light").result(60) == 1 << 24
        (replacement,) = children()
        assert replacement.pid != process.pid
    finally:
        workers.close()
    assert not children()


def test_a_worker_that_dies_idle_or_cannot_send_its_answer_is_no_end() -> None:
    workers = LocalBackend((LIGHT,))
    try:
        _, pid = submit(workers, task, "a", "light").result(60)
        os.kill(pid, signal.SIGKILL)
        died = "no"
        try:
            _, pid = submit(workers, task, "b", "light").result(60)
        except WorkerDied as error:  # found out only when it is asked
            died = str(error)
        assert died == "no" or "SIGKILL" in died
        with pytest.raises(TypeError, match="cannot pickle"):
            submit(workers, open, os.devnull, "light").result(60)
        assert submit(workers, task, "c", "light").result(60)[0] == "c"
    finally:
        workers.close()


# A module of the standard library that nothing here imports.
LOADED = "wave"


def seen(name: str) -> tuple[int, int, bool, str | None, str]:
    """(process, parent, whether LOADED is, an environment variable, the folder)."""
    folder = os.getcwd()
    return os.getpid(), os.getppid(), LOADED in sys.modules, os.environ.get(name), folder


@pytest.fixture
def none_before() -> Iterator[None]:
    """Nor after a test."""
    template.kill()
    yield
    template.kill()
    assert not children()


def report_of_worker() -> tuple[int, int, bool, str]:
    """(process, parent, whether LOADED is, OMP_NUM_THREADS) of a worker."""
    backend = LocalBackend((LIGHT,), preload=(LOADED,))
    try:
        actual = submit(backend, seen, "OMP_NUM_THREADS", "light").result(60)
    finally:
        backend.close()
    assert actual[3] is not None
    return actual[0], actual[1], actual[2], actual[3]


@pytest.mark.slow
@pytest.mark.usefixtures("none_before")
def test_what_was_loaded_is_there_and_nothing_is_forked_from_this_process() -> None:
    _, parent, loaded, threads = report_of_worker()
    assert (loaded, threads) == (True, "1")
    assert parent != os.getpid()
    assert report_of_worker()[1] == parent


@pytest.mark.usefixtures("none_before")
def test_environment_and_folder_are_those_of_now(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setenv("SIMNFND_TEST_GONE", "1")
    template.start((LOADED,))
    monkeypatch.delenv("SIMNFND_TEST_GONE")
    monkeypatch.setenv("SIMNFND_TEST_NEW", "2")
    monkeypatch.chdir(str(tmp_path))
    backend = LocalBackend((LIGHT,), preload=(LOADED,))
    try:
        for name, value in (("SIMNFND_TEST_GONE", None), ("SIMNFND_TEST_NEW", "2")):
            *_, loaded, message, folder = submit(backend, seen, name, "light").result(60)
            assert (loaded, message, folder) == (True, value, str(tmp_path))
    finally:
        backend.close()


@pytest.mark.slow
@pytest.mark.usefixtures("none_before")
def test_one_that_hangs_is_killed_and_the_worker_comes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(local, "_BEGIN_S", 2.0)
    template.start((LOADED,))
    psutil.Process(template_pid()).suspend()
    begun = time.monotonic()
    assert report_of_worker()[:2] != (0, 0)
    assert 2.0 <= time.monotonic() - begun < 30.0


@pytest.mark.usefixtures("none_before")
def test_it_goes_with_the_process_that_started_it() -> None:
    code = (
        "import sys, time; from simnfnd.factory.common.workers import template;"
        f"template.start(({LOADED!r},)); print('up', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=ROOT) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == b"up\n"
        below = psutil.Process(run.pid).children(recursive=True)
        assert below
        run.kill()
        # It ends with the pipe's end, too: no reader of the command's output waits for it.
        run.stdout.read()
    _, alive = psutil.wait_procs(below, timeout=20)
    assert not alive
