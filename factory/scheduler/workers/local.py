"""Worker processes on this machine: single-threaded, replaceable, gone when we go.

Every wait here ends: each worker has one deadline, put off by all that it tells, and one thread
kills whoever misses it.  What was said to a process that is dead fails at once, because the two
share a pair of sockets that nobody else has.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import pickle
import signal
import threading
import time
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import psutil

from . import template
from .contract import ERROR, RESULT, Hear, Pool, WorkerSettings, answered, start_worker_process

T = TypeVar("T")

# For a process to be there, for its task to begin in a new one, which imports what it needs, and
# in one that has run others.
_PROCESS_S, _FIRST_S, _BEGIN_S = 60.0, 300.0, 30.0
# To end by itself once its connection is closed, or to be gone when it was killed.
_END_S = 5.0
_LOOK_S = 0.5
_STOP_S = 10.0
_NEWS = "news"


class WorkerDied(Exception):
    """The process ended, or had to be ended, before it answered."""


class LocalBackend:
    """Worker processes on this machine; a `contract.Backend`.

    Whatever kills a worker costs the task it had in hand, and nothing else.
    """

    def __init__(self, settings: WorkerSettings) -> None:
        # Read when a library is loaded, so set before a worker exists; recycled ones read it too.
        self._saved = template.one_thread()
        template.start(settings.preload)
        forks = bool(settings.preload)
        self._places = [_Place(pool, forks) for pool in settings.pools for _ in range(pool.workers)]
        self._stopped = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while not self._stopped.wait(_LOOK_S):
            for place in tuple(self._places):
                place.kill_if_late()

    def free(self, pool: str) -> bool:
        """Whether a worker waits for a task of this pool."""
        return any(place.free and place.pool.takes(pool) for place in self._places)

    def submit(
        self,
        function: Callable[[Any], T],
        argument: Any,
        silence_s: float,
        pool: str,
        hear: Hear | None = None,
    ) -> Future[T]:
        """Run `function(argument)` in a free worker; it is killed when it is silent for longer."""
        fit = (place for place in self._places if place.free and place.pool.takes(pool))
        place = min(fit, key=lambda place: place.pool.name != pool)
        # To the end of the line, so that all get their share of the work.
        self._places.remove(place)
        self._places.append(place)
        return place.submit(function, argument, silence_s, hear)

    def poll(self) -> None:
        """Nothing: threads wait for the workers."""

    def why_died(self, error: BaseException) -> str | None:
        """What killed the worker, if that is what `error` of a future means; else None."""
        return str(error) if isinstance(error, WorkerDied) else None

    def stop(self) -> None:
        """Kill the workers now; files are whole or absent if tasks write them atomically."""
        self._stopped.set()
        for place in self._places:
            place.stop()
        deadline = time.monotonic() + _STOP_S
        for place in self._places:
            # One may have been starting its process at that very moment.
            while not place.closed(0.05) and time.monotonic() < deadline:
                place.stop()
        template.restore(self._saved)


class _Place:
    """A place for one worker process; each of its tasks is a talk, in a thread of its own.

    The process is no fork of this one, which may have rendered and does not survive a fork.
    """

    def __init__(self, pool: Pool, forks: bool) -> None:
        """forks: start processes as forks of the template where there is one."""
        self.pool = pool
        self._forks = forks
        self._future: Future[Any] | None = None
        self._talking = threading.Lock()
        self._child: _Child | None = None
        self._deadline = math.inf
        self._stopped = False

    @property
    def free(self) -> bool:
        """Whether a task would be begun at once."""
        return self._future is None or self._future.done()

    def submit(
        self, function: Callable[[Any], T], argument: Any, silence_s: float, hear: Hear | None
    ) -> Future[T]:
        """Run `function(argument)`; TimeoutError or WorkerDied when there is no answer."""
        future: Future[T] = Future()
        future.set_running_or_notify_cancel()
        self._future = future
        try:
            request = pickle.dumps((function, argument))
        except Exception as error:
            future.set_exception(error)
        else:
            given = (future, request, silence_s, hear)
            threading.Thread(target=self._talk, args=given, daemon=True).start()
        return future

    def _talk(
        self, future: Future[Any], request: bytes, silence_s: float, hear: Hear | None
    ) -> None:
        # Only the main thread answers Ctrl-C, and no process that this one starts.
        template.hold_interrupts()
        with self._talking:
            kind, value = ERROR, None
            try:
                kind, value = self._answer(request, silence_s, hear)
            except BaseException as error:
                value = error
            self._deadline = math.inf
            if kind == RESULT:
                future.set_result(value)
            else:
                future.set_exception(value)
            child = self._child
            if child and (not child.alive or child.answered == self.pool.tasks_per_worker > 0):
                self._child = None
                child.end()

    def _answer(self, request: bytes, silence_s: float, hear: Hear | None) -> tuple[str, Any]:
        """What comes of the task.  TimeoutError or WorkerDied: the process is gone."""
        if self._child is None or not self._child.alive:
            self._child = None
            self._deadline = time.monotonic() + _PROCESS_S
            self._child = _Child(self._forks)
        child, begun = self._child, False
        self._deadline = time.monotonic() + (_BEGIN_S if child.answered else _FIRST_S)
        if self._stopped:  # while it was being started
            child.kill()
        try:
            child.connection.send_bytes(request)
            while True:
                kind, value = child.received()
                if kind != _NEWS:
                    child.answered += 1
                    return kind, value
                self._deadline, begun = time.monotonic() + silence_s, True
                if value and hear:
                    hear(value)
        except (EOFError, OSError):
            if time.monotonic() < self._deadline:
                raise WorkerDied(_exit_text(child.end())) from None
            child.end(at_once=True)
            if begun:
                raise TimeoutError from None
            raise WorkerDied("it stood still before it had begun") from None

    def kill_if_late(self) -> None:
        """Kill what keeps the task waiting, once it does so for too long."""
        if time.monotonic() > self._deadline:
            (self._child.kill if self._child else template.kill)()

    def stop(self) -> None:
        """Kill the process and start no other; does not wait."""
        self._stopped = True
        if child := self._child:
            child.kill()

    def closed(self, timeout_s: float) -> bool:
        """Wait for the end of a stopped place; returns whether it came."""
        if not self._talking.acquire(timeout=timeout_s):
            return False
        if self._child:
            self._child.end(at_once=True)
        return True


class _Child:
    """A worker process and our end of the connection to it.

    Whether it lives is not asked of `multiprocessing`: once the template is dead, that takes every
    fork of it for dead and kills none.
    """

    def __init__(self, forks: bool) -> None:
        self.answered = 0
        self.connection, theirs = multiprocessing.Pipe()
        try:
            self._process = template.started(forks, _work, (theirs, dict(os.environ)))
        except BaseException:
            self.connection.close()
            raise
        finally:
            # So that its end of the connection ends with it.
            theirs.close()
        self._running: psutil.Process | None = None
        with suppress(psutil.Error):  # gone already
            self._running = psutil.Process(self._process.pid)
        # At its end, multiprocessing would wait for all that live.
        weakref.finalize(self, _kill, self._running)

    @property
    def alive(self) -> bool:
        return not self.connection.closed and self._runs()

    def _runs(self) -> bool:
        with suppress(psutil.Error):
            if self._running and self._running.is_running():
                return self._running.status() != psutil.STATUS_ZOMBIE
        return False

    def kill(self) -> None:
        _kill(self._running)

    def received(self) -> tuple[str, Any]:
        """The next thing that it says.  Raises EOFError or OSError when it is gone."""
        # A copy of its end may live on in a process that something else here has forked.
        while not self.connection.poll(_LOOK_S):
            if not self._runs() and not self.connection.poll():
                raise EOFError
        kind, value = pickle.loads(self.connection.recv_bytes())
        return kind, value

    def end(self, *, at_once: bool = False) -> int | None:
        """Let the process end; its exit code, None when even a kill did not end it."""
        self.connection.close()
        if at_once or not self._gone():
            self.kill()
        gone = self._gone()
        self._process.join(_LOOK_S if gone else 0)
        return self._process.exitcode if gone else None

    def _gone(self) -> bool:
        """Whether the process ends in time."""
        end = time.monotonic() + _END_S
        while self._runs():
            if time.monotonic() > end:
                return False
            time.sleep(0.01)
        return True


def _kill(process: psutil.Process | None) -> None:
    with suppress(psutil.Error):  # gone already
        if process:
            process.kill()


def _work(connection: Connection, environment: dict[str, str]) -> None:
    """What the process does until its connection is closed.

    environment: of the parent as it is now; a template may have been started with another.
    """
    os.environ.clear()
    os.environ.update(environment)
    start_worker_process()
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    # Closed while we work: nobody waits for what we do.
    with suppress(EOFError, OSError):
        while True:
            answer = answered(
                connection.recv_bytes(),
                lambda message: connection.send_bytes(pickle.dumps((_NEWS, message))),
            )
            connection.send_bytes(answer)


def _exit_with_parent() -> None:
    """A killed parent cannot stop its workers, so they watch for its end themselves."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _exit_text(exitcode: int | None) -> str:
    if exitcode is None:
        return "its worker process stands still and cannot be killed"
    if exitcode >= 0:
        return f"its worker process ended with exit code {exitcode}"
    try:
        name = signal.Signals(-exitcode).name
    except ValueError:
        name = f"signal {-exitcode}"
    hint = ", perhaps for want of memory" if name == "SIGKILL" else ""
    return f"native crash, its worker process was killed by {name}{hint}"
