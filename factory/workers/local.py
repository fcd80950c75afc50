"""Worker processes on this machine: spawned, single-threaded, replaceable, gone when we go."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import resource_tracker
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any, TypeVar

from pebble import ProcessExpired, ProcessPool

from simnfnd.factory.workers.contract import Pool, WorkerSettings
from simnfnd.factory.workers.start import start_worker_process

T = TypeVar("T")

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "OPENCV_FOR_THREADS_NUM",
)
_STOP_S = 10.0


class _RememberingContext(SpawnContext):
    """Spawn, and remember what was started, so that stopping need not ask it politely."""

    def __init__(self) -> None:
        super().__init__()
        self.started: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]
        self.started = [process for process in self.started if process.exitcode is None]
        process = SpawnProcess(*args, **kwargs)
        self.started.append(process)
        return process


class _Slot:
    """One worker process and, one after another, those that replace it.

    A pebble pool of one: pebble's workers share pipes and locks, so that one which is killed at
    the wrong moment, or while it has no task, breaks the pool for all.  Alone, it breaks its own.
    """

    def __init__(self, pool: Pool) -> None:
        self.pool = pool
        self.context = _RememberingContext()
        self.future: Future[Any] | None = None
        self._process: Any = None

    @property
    def free(self) -> bool:
        return self.future is None or self.future.done()

    def submit(self, function: Callable[..., T], argument: Any, timeout_s: float) -> Future[T]:
        self.start()
        future: Future[T] = self._process.schedule(function, args=[argument], timeout=timeout_s)
        self.future = future
        return future

    def start(self) -> None:
        if self._process is None or not self._process.active:
            self.stop()
            self.join()
            self._process = self._new_process()

    def stop(self) -> None:
        if self._process is not None:
            self._process.stop()

    def kill(self) -> bool:
        """Kill what runs; returns whether anything did."""
        running = [process for process in self.context.started if process.is_alive()]
        for process in running:
            process.kill()
        return bool(running)

    def join(self) -> None:
        if self._process is not None:
            self._process.join()

    def _new_process(self) -> Any:
        process = ProcessPool(
            max_workers=1,
            max_tasks=self.pool.tasks_per_worker,
            initializer=_start_worker,
            context=self.context,
        )
        with _interrupts_held():
            # Asking starts the pool's threads and worker, which inherit that Ctrl-C is held: it
            # goes to the whole process group, and only the parent may answer it.
            assert process.active
        return process


class LocalBackend:
    """Worker processes on this machine; a `contract.Backend`.

    Start method spawn, because a process that has rendered does not survive a fork.  Whatever
    kills a worker costs the task it had in hand, and nothing else.
    """

    def __init__(self, settings: WorkerSettings) -> None:
        # Read when a library is loaded, so set before a worker exists; recycled ones read it too.
        self._saved = {name: os.environ.get(name) for name in THREAD_VARIABLES}
        os.environ.update(dict.fromkeys(THREAD_VARIABLES, str(settings.threads)))
        self._slots = [_Slot(pool) for pool in settings.pools for _ in range(pool.workers)]
        if settings.start_all:
            for slot in self._slots:
                slot.start()

    def free(self, pool: str) -> bool:
        """Whether a worker waits for a task of this pool."""
        return any(slot.free and slot.pool.takes(pool) for slot in self._slots)

    def submit(
        self, function: Callable[..., T], argument: Any, timeout_s: float, pool: str
    ) -> Future[T]:
        """Run `function(argument)` in a free worker; it is killed when it takes longer."""
        fit = (slot for slot in self._slots if slot.free and slot.pool.takes(pool))
        slot = min(fit, key=lambda slot: slot.pool.name != pool)
        # To the end of the line, so that all get their share of the work.
        self._slots.remove(slot)
        self._slots.append(slot)
        return slot.submit(function, argument, timeout_s)

    def expire(self, future: Future[Any]) -> None:
        """Kill the worker that has the task in hand."""
        for slot in self._slots:
            if slot.future is future and not future.done():
                slot.kill()

    def poll(self) -> None:
        """Nothing: pebble watches the time limits."""

    def why_died(self, error: BaseException) -> str | None:
        """What killed the worker, if that is what `error` of a future means; else None."""
        if isinstance(error, ProcessExpired):
            return _exit_text(error.exitcode)
        return "its worker process died" if isinstance(error, BrokenProcessPool) else None

    def stop(self) -> None:
        """Kill the workers now; files are whole or absent if tasks write them atomically."""
        for slot in self._slots:
            slot.stop()
        joiner = threading.Thread(target=self._join, daemon=True)
        joiner.start()
        deadline = time.monotonic() + _STOP_S
        # A pool may be starting a worker at this very moment, so repeat until none is left.  The
        # threads of pools are daemons and hold nothing of ours, should they not notice in time.
        while (self._kill_workers() or joiner.is_alive()) and time.monotonic() < deadline:
            joiner.join(0.02)
        for name, value in self._saved.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

    def _join(self) -> None:
        for slot in self._slots:
            slot.join()

    def _kill_workers(self) -> bool:
        """Kill what runs; returns whether anything did."""
        return any([slot.kill() for slot in self._slots])


def _start_worker() -> None:
    start_worker_process()
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """A killed parent cannot stop its workers, so they watch for its end themselves."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


@contextmanager
def _interrupts_held() -> Iterator[None]:
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Its start would lift the hold, so it has to run before.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _exit_text(exitcode: int) -> str:
    if exitcode >= 0:
        return f"its worker process ended with exit code {exitcode}"
    try:
        name = signal.Signals(-exitcode).name
    except ValueError:
        name = f"signal {-exitcode}"
    hint = ", perhaps for want of memory" if name == "SIGKILL" else ""
    return f"native crash, its worker process was killed by {name}{hint}"
