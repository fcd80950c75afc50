"""Worker processes on this machine: single-threaded, replaceable, gone when we go.

Every wait here ends: a process that is silent for too long is killed, and what was said to a
process that is dead fails at once, because the two share a pair of sockets that nobody else has.
"""

from __future__ import annotations

import atexit
import math
import multiprocessing
import os
import pickle
import select
import signal
import threading
import time
import traceback
import weakref
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, TypeVar

from . import template
from .contract import Hear, Pool, WorkerSettings, heard_by, start_worker_process

T = TypeVar("T")

# An interpreter starts and a task's modules are imported, on a machine that is busy.
_START_S = 300.0
# To end by itself once its connection is closed, or to be gone when it was killed.
_END_S = 5.0
_LOOK_S = 1.0
_STOP_S = 10.0
_BEGUN, _NEWS, _RESULT, _ERROR = "begun", "news", "result", "error"


class WorkerDied(Exception):
    """The process ended, or had to be ended, before it answered."""


@dataclass(frozen=True)
class _Task:
    request: bytes
    silence_s: float
    future: Future[Any]
    hear: Hear | None = None


class LocalBackend:
    """Worker processes on this machine; a `contract.Backend`.

    Whatever kills a worker costs the task it had in hand, and nothing else.
    """

    def __init__(self, settings: WorkerSettings) -> None:
        # Read when a library is loaded, so set before a worker exists; recycled ones read it too.
        self._saved = template.tell(settings.threads)
        template.start(settings.preload, settings.threads)
        forks = bool(settings.preload)
        self._slots = [_Slot(pool, forks) for pool in settings.pools for _ in range(pool.workers)]
        if settings.start_all:
            for slot in self._slots:
                slot.start()

    def free(self, pool: str) -> bool:
        """Whether a worker waits for a task of this pool."""
        return any(slot.free and slot.pool.takes(pool) for slot in self._slots)

    def submit(
        self,
        function: Callable[..., T],
        argument: Any,
        silence_s: float,
        pool: str,
        hear: Hear | None = None,
    ) -> Future[T]:
        """Run `function(argument)` in a free worker; it is killed when it is silent for longer."""
        fit = (slot for slot in self._slots if slot.free and slot.pool.takes(pool))
        slot = min(fit, key=lambda slot: slot.pool.name != pool)
        # To the end of the line, so that all get their share of the work.
        self._slots.remove(slot)
        self._slots.append(slot)
        return slot.submit(function, argument, silence_s, hear)

    def poll(self) -> None:
        """Nothing: each worker's own thread watches it."""

    def why_died(self, error: BaseException) -> str | None:
        """What killed the worker, if that is what `error` of a future means; else None."""
        return str(error) if isinstance(error, WorkerDied) else None

    def stop(self) -> None:
        """Kill the workers now; files are whole or absent if tasks write them atomically."""
        for slot in self._slots:
            slot.stop()
        deadline = time.monotonic() + _STOP_S
        for slot in self._slots:
            while not slot.join(0.05) and time.monotonic() < deadline:
                # One may have been starting its process at that very moment.
                slot.kill()
        template.restore(self._saved)


class _Slot:
    """A place for one worker process; a thread of its own waits for it.

    The process is no fork of this one, which may have rendered and does not survive a fork.
    """

    def __init__(self, pool: Pool, forks: bool) -> None:
        """forks: start processes as forks of the template where there is one."""
        self.pool = pool
        self._forks = forks
        self._future: Future[Any] | None = None
        self._tasks: SimpleQueue[_Task | None] = SimpleQueue()
        self._child: _Child | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def free(self) -> bool:
        """Whether a task would be begun at once."""
        return self._future is None or self._future.done()

    def start(self) -> None:
        """Start the process before there is a task."""
        self._tasks.put(_Task(b"", _START_S, Future()))

    def submit(
        self, function: Callable[..., T], argument: Any, silence_s: float, hear: Hear | None
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
            self._tasks.put(_Task(request, silence_s, future, hear))
        return future

    def kill(self) -> None:
        """Kill the process, if there is one."""
        if child := self._child:
            child.kill()

    def stop(self) -> None:
        """Kill the process and start no other; does not wait."""
        self._stopped = True
        self._tasks.put(None)
        self.kill()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end of a stopped slot; returns whether it came."""
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _serve(self) -> None:
        # Only the main thread answers Ctrl-C, and no process that this one starts.
        template.hold_interrupts()
        while (task := self._tasks.get()) is not None:
            try:
                if self._stopped:
                    raise WorkerDied("it was stopped")
                answer = self._answer(task)
            except BaseException as error:
                task.future.set_exception(error)
            else:
                task.future.set_result(answer)
            child = self._child
            if child and (not child.alive or child.answered == self.pool.tasks_per_worker > 0):
                self._child = None
                child.end()
        if self._child:
            self._child.kill()
            self._child.end()

    def _answer(self, task: _Task) -> Any:
        if self._child is None or not self._child.alive:
            self._child = _Child(self._forks)
        if self._stopped:  # while it was being started
            self._child.kill()
        return self._child.ask(task) if task.request else None


class _Child:
    """A worker process and our end of the connection to it.

    It is known by a file of its process (pidfd), not by what `multiprocessing` says: once the
    template is dead, that takes every fork of it for dead and kills none.
    """

    def __init__(self, forks: bool) -> None:
        self.answered = 0
        self._connection, theirs = multiprocessing.Pipe()
        try:
            self._process = template.started(forks, _START_S, _work, (theirs, dict(os.environ)))
        except BaseException:
            self._connection.close()
            raise
        finally:
            # So that its end of the connection ends with it.
            theirs.close()
        self._pid, self._pidfd = self._process.pid or 0, -1
        with suppress(AttributeError, OSError):  # not Linux, or gone already
            self._pidfd = os.pidfd_open(self._pid)
        _children.add(self)

    @property
    def alive(self) -> bool:
        return not self._connection.closed and not self._gone(0.0)

    def _gone(self, within_s: float) -> bool:
        """Whether the process ends within so many seconds."""
        if self._pidfd < 0:
            self._process.join(within_s)
            return not self._process.is_alive()
        waiting = select.poll()  # a `select` takes no file with a high number
        waiting.register(self._pidfd, select.POLLIN)
        return bool(waiting.poll(1000 * within_s))

    def kill(self) -> None:
        with suppress(ValueError, OSError):  # gone already
            if self._pidfd >= 0:
                signal.pidfd_send_signal(self._pidfd, signal.SIGKILL)
            else:
                self._process.kill()

    def ask(self, task: _Task) -> Any:
        """What the task returns, or raises.  TimeoutError or WorkerDied: the process is gone."""
        limit_s, begun = _START_S, False
        try:
            # What is larger than the pipe's buffer waits for the process to read it.
            with template.limited(self._pid, self.kill, limit_s, template.STOPPED_S):
                self._connection.send_bytes(task.request)
            while True:
                kind, value = self._received(limit_s, begun)
                if kind == _BEGUN:
                    limit_s, begun = task.silence_s, True
                elif kind == _NEWS:
                    if task.hear:
                        task.hear(value)
                else:
                    break
        except TimeoutError:
            self.end(at_once=True)
            if begun:
                raise
            raise WorkerDied("it stood still before it had begun") from None
        except (EOFError, OSError):
            raise WorkerDied(_exit_text(self.end())) from None
        self.answered += 1
        if kind == _RESULT:
            return value
        raise value

    def _received(self, limit_s: float, begun: bool) -> tuple[str, Any]:
        # It has minutes to load what it needs, but not to stand still.
        stopped_s = math.inf if begun else template.STOPPED_S
        with template.limited(self._pid, self.kill, limit_s, stopped_s):
            # A copy of its end may live on in a process that something else here has forked.
            while not self._connection.poll(_LOOK_S):
                if self._gone(0.0) and not self._connection.poll():
                    raise EOFError
            kind, value = pickle.loads(self._connection.recv_bytes())
            return kind, value

    def end(self, *, at_once: bool = False) -> int | None:
        """Let the process end; its exit code, None when even a kill did not end it."""
        self._connection.close()
        if at_once or not self._gone(_END_S):
            self.kill()
        gone = self._gone(_END_S)
        self._process.join(_LOOK_S if gone else 0)
        if self._pidfd >= 0:
            pidfd, self._pidfd = self._pidfd, -1
            os.close(pidfd)
        return self._process.exitcode if gone else None


# At its end, multiprocessing would wait for all that live.
_children: weakref.WeakSet[_Child] = weakref.WeakSet()


@atexit.register
def _kill_children() -> None:
    for child in list(_children):
        child.kill()


def _work(connection: Connection, environment: dict[str, str]) -> None:
    """What the process does until its connection is closed.

    environment: of the parent as it is now; a template may have been started with another.
    """
    os.environ.clear()
    os.environ.update(environment)
    start_worker_process()
    threading.Thread(target=_exit_with_parent, daemon=True).start()

    def say(kind: str, value: Any = None) -> None:
        connection.send_bytes(pickle.dumps((kind, value)))

    # Closed while we work: nobody waits for what we do.
    with suppress(EOFError, OSError):
        while True:
            request = connection.recv_bytes()
            try:
                function, argument = pickle.loads(request)
                say(_BEGUN)
                with heard_by(lambda message: say(_NEWS, message)):
                    answer = pickle.dumps((_RESULT, function(argument)))
            except BaseException as error:
                answer = _pickled(error)
            connection.send_bytes(answer)


def _pickled(error: BaseException) -> bytes:
    """The error with its traceback as a note, or its text when it cannot be sent."""
    told = "".join(traceback.format_exception(error))
    with suppress(Exception):
        error.add_note(told)
        answer = pickle.dumps((_ERROR, error))
        pickle.loads(answer)
        return answer
    return pickle.dumps((_ERROR, RuntimeError(told)))


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
