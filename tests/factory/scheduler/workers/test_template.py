"""Workers that are forked from a process which has loaded what they need."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator

import psutil
import pytest

from simnfnd.factory.scheduler.workers import local, template
from simnfnd.factory.scheduler.workers.contract import Pool, WorkerSettings
from simnfnd.factory.scheduler.workers.local import LocalBackend
from tests.project_files import ROOT
from tests.worker_processes import workers_of

POOL = Pool("light", 1)
# A module of the standard library that nothing here imports.
LOADED = "wave"


def seen(name: str) -> tuple[int, int, bool, str | None, str]:
    """(process, parent, whether LOADED is, an environment variable, the folder)."""
    folder = os.getcwd()
    return os.getpid(), os.getppid(), LOADED in sys.modules, os.environ.get(name), folder


@pytest.fixture(autouse=True)
def none_before() -> Iterator[None]:
    """Nor after a test."""
    template.kill()
    yield
    template.kill()
    assert not workers_of(os.getpid())


def asked() -> tuple[int, int, bool, str]:
    """(process, parent, whether LOADED is, OMP_NUM_THREADS) of a worker."""
    backend = LocalBackend(WorkerSettings((POOL,), preload=(LOADED,)))
    try:
        found = backend.submit(seen, "OMP_NUM_THREADS", 60.0, POOL.name).result(60)
    finally:
        backend.stop()
    assert found[3] is not None
    return found[0], found[1], found[2], found[3]


def test_what_was_loaded_is_there_and_nothing_is_forked_from_this_process() -> None:
    _, parent, loaded, threads = asked()
    assert (loaded, threads) == (True, "1")
    assert parent != os.getpid()
    assert asked()[1] == parent


def test_environment_and_folder_are_those_of_now(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setenv("SIMNFND_TEST_GONE", "1")
    template.start((LOADED,))
    monkeypatch.delenv("SIMNFND_TEST_GONE")
    monkeypatch.setenv("SIMNFND_TEST_NEW", "2")
    monkeypatch.chdir(str(tmp_path))
    backend = LocalBackend(WorkerSettings((POOL,), preload=(LOADED,)))
    try:
        for name, value in (("SIMNFND_TEST_GONE", None), ("SIMNFND_TEST_NEW", "2")):
            *_, loaded, told, folder = backend.submit(seen, name, 60.0, POOL.name).result(60)
            assert (loaded, told, folder) == (True, value, str(tmp_path))
    finally:
        backend.stop()


def the_template() -> psutil.Process:
    """Its process; one that was forked a moment ago has the words of this one still."""
    end = time.monotonic() + 10
    while True:
        found = psutil.Process().children()
        named = [child for child in found if "forkserver" in " ".join(child.cmdline())]
        if named or time.monotonic() > end:
            (one,) = named
            return one
        time.sleep(0.01)


def test_one_that_stands_still_is_killed_and_the_worker_comes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(local, "_PROCESS_S", 2.0)
    template.start((LOADED,))
    the_template().suspend()
    begun = time.monotonic()
    assert asked()[:2] != (0, 0)
    assert 2.0 <= time.monotonic() - begun < 30.0


def test_it_goes_with_the_process_that_started_it() -> None:
    code = (
        "import sys, time; from simnfnd.factory.scheduler.workers import template;"
        f"template.start(({LOADED!r},)); print('up', flush=True); time.sleep(60)"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, cwd=ROOT) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == b"up\n"
        below = psutil.Process(run.pid).children(recursive=True)
        assert below
        run.kill()
        # It ends with the pipe's end, too: nobody who reads from the command waits for it.
        run.stdout.read()
    _, alive = psutil.wait_procs(below, timeout=20)
    assert not alive
