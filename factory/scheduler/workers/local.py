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
from contextlib import ExitStack, closing, suppress
from multiprocessing.connection import Connection
from typing import Any, TypeVar

import psutil

from . import ERROR, Backend, Hear, Pool, WorkerDied, answered, start_worker_process, template

T = TypeVar("T")

# For a process to be there, for its task to begin in a new one, which imports what it needs, and
# in one that has run others.
_PROCESS_S, _FIRST_S, _BEGIN_S = 60.0, 300.0, 30.0
# To be gone when it was killed.
_END_S = 5.0
_LOOK_S = 0.5
_STOP_S = 10.0
_NEWS = "news"


class LocalBackend(Backend):
    """Worker processes on this machine.

    Whatever kills a worker costs the task it had in hand, and nothing else.
    """

    def __init__(self, pools: tuple[Pool, ...], preload: tuple[str, ...] = ()) -> None:
        """preload: modules that every worker needs, loaded once for all."""
        self._block = ExitStack()
        # Read when a library is loaded, so set before a worker exists; recycled ones read it too.
        self._block.enter_context(template.one_thread())
        template.start(preload)
        self._places = [_Place(pool, bool(preload)) for pool in pools for _ in range(pool.workers)]
        self._stopped = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while not self._stopped.wait(_LOOK_S):
            for place in tuple(self._places):
                place.kill_if_late()

    def free(self, kind: str) -> bool:
        """Whether a worker waits for a task of this kind."""
        return any(place.free and kind in place.pool.kinds for place in self._places)

    def submit(
        self,
        function: Callable[[Any], T],
        argument: Any,
        silence_s: float,
        kind: str,
        hear: Hear | None = None,
    ) -> Future[T]:
        """Run `function(argument)` in a free worker; it is killed when it is silent for longer."""
        fit = (place for place in self._places if place.free and kind in place.pool.kinds)
        place = min(fit, key=lambda place: place.pool.kinds[0] != kind)
        # To the end of the line, so that all get their share of the work.
        self._places.remove(place)
        self._places.append(place)
        request = pickle.dumps((function, argument))
        place.future = future = Future[T]()
        given = (future, request, silence_s, hear)
        threading.Thread(target=place.talk, args=given, daemon=True).start()
        return future

    def close(self) -> None:
        """Kill the workers now."""
        self._stopped.set()
        left, deadline = self._places, time.monotonic() + _STOP_S
        # One may have been starting its process at that very moment.
        while (left := [one for one in left if not one.closed()]) and time.monotonic() < deadline:
            time.sleep(0.01)
        self._block.close()


class _Place:
    """A place for one worker process; each of its tasks is a talk, in a thread of its own.

    The process is no fork of this one, which may have rendered and does not survive a fork.
    """

    def __init__(self, pool: Pool, forks: bool) -> None:
        """forks: start processes as forks of the template where there is one."""
        self.pool = pool
        self.future: Future[Any] | None = None
        self._forks = forks
        self._talking = threading.Lock()
        self._child: _Child | None = None
        self._deadline = math.inf
        self._stopped = False

    @property
    def free(self) -> bool:
        """Whether a task would be begun at once."""
        return self.future is None or self.future.done()

    def talk(
        self, future: Future[Any], request: bytes, silence_s: float, hear: Hear | None
    ) -> None:
        """Give the future what comes of the request."""
        # Only the main thread answers Ctrl-C, and no process that this one starts.
        template.hold_interrupts()
        with self._talking:
            try:
                kind, value = self._answer(request, silence_s, hear)
                if kind == ERROR:
                    raise value
                future.set_result(value)
            except BaseException as error:
                future.set_exception(error)

    def _answer(self, request: bytes, silence_s: float, hear: Hear | None) -> tuple[str, Any]:
        """What comes of the task.  TimeoutError or WorkerDied: the process is gone."""
        child, begun = self._child, False
        if child and (child.answered == self.pool.tasks_per_worker > 0 or not child.runs()):
            child.end()
            self._child = child = None
        if child is None:
            self._deadline = time.monotonic() + _PROCESS_S
            self._child = child = _Child(self._forks)
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
            late = time.monotonic() >= self._deadline
            exitcode = child.end(0 if late else _END_S)
            if late and begun:
                raise TimeoutError from None
            reason = "it stood still before it had begun" if late else _exit_text(exitcode)
            raise WorkerDied(reason) from None
        finally:
            self._deadline = math.inf

    def kill_if_late(self) -> None:
        """Kill what keeps the task waiting, once it does so for too long."""
        if time.monotonic() > self._deadline:
            (self._child.kill if self._child else template.kill)()

    def closed(self) -> bool:
        """Kill the process and start no other; returns whether it has ended."""
        self._stopped = True
        if child := self._child:
            child.kill()
        if not self._talking.acquire(blocking=False):
            return False
        if self._child:
            self._child.end()
        return True


class _Child:
    """A worker process and our end of the connection to it.  Raises WorkerDied when it is gone.

    Whether it lives is not asked of `multiprocessing`: once the template is dead, that takes every
    fork of it for dead and kills none.
    """

    def __init__(self, forks: bool) -> None:
        self.answered = 0
        self.connection, theirs = multiprocessing.Pipe()
        with closing(theirs):  # so that its end of the connection ends with it
            self._process = template.started(forks, _work, (theirs, dict(os.environ)))
        try:
            self._running = psutil.Process(self._process.pid)
        except psutil.NoSuchProcess:
            raise WorkerDied("its worker process ended at once") from None
        # At its end, multiprocessing would wait for all that live.
        weakref.finalize(self, _kill, self._running)

    def runs(self) -> bool:
        with suppress(psutil.Error):
            return self._running.is_running() and self._running.status() != psutil.STATUS_ZOMBIE
        return False

    def kill(self) -> None:
        _kill(self._running)

    def received(self) -> tuple[str, Any]:
        """The next thing that it says.  Raises EOFError or OSError when it is gone."""
        # A copy of its end may live on in a process that something else here has forked.
        while not self.connection.poll(_LOOK_S):
            if not self.runs() and not self.connection.poll():
                raise EOFError
        kind, value = pickle.loads(self.connection.recv_bytes())
        return kind, value

    def end(self, patience_s: float = 0) -> int | None:
        """Kill the process unless it ends before; its exit code, None when even that did not do."""
        self.connection.close()
        for wait_s in (patience_s, _END_S):
            end = time.monotonic() + wait_s
            while self.runs() and time.monotonic() < end:
                time.sleep(0.01)
            self.kill()
        self._process.join(0 if self.runs() else _LOOK_S)
        return self._process.exitcode


def _kill(process: psutil.Process) -> None:
    with suppress(psutil.Error):  # gone already
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
    if exitcode is None or exitcode >= 0:
        return f"its worker process ended with exit code {exitcode}"
    names = {number.value: number.name for number in signal.Signals}
    name = names.get(-exitcode, f"signal {-exitcode}")
    hint = ", perhaps for want of memory" if name == "SIGKILL" else ""
    return f"native crash, its worker process was killed by {name}{hint}"
