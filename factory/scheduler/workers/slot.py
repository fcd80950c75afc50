"""One worker process at a time: started when there is a task, watched, and replaced when it dies.

Every wait here ends: a process that is too late, with its start or with its task, is killed, and
what was said to a process that is dead fails at once, because the two share a pair of sockets
that nobody else has.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import pickle
import signal
import threading
import time
import traceback
import weakref
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import Any, TypeVar

from . import template
from .contract import Pool
from .start import start_worker_process

T = TypeVar("T")

# An interpreter starts and a task's modules are imported, on a machine that is busy.
_START_S = 300.0
# To end by itself once its connection is closed, or to be gone when it was killed.
_END_S = 5.0
_LOOK_S = 1.0
_BEGUN = b"begun"


class WorkerDied(Exception):
    """The process ended, or had to be ended, before it answered."""


@dataclass(frozen=True)
class _Task:
    request: bytes
    timeout_s: float
    future: Future[Any]


class Slot:
    """A place for one worker process; a thread of its own waits for it.

    The process is no fork of this one, which may have rendered and does not survive a fork.
    """

    def __init__(self, pool: Pool, forks: bool = False) -> None:
        """forks: start processes as forks of the template where there is one."""
        self.pool = pool
        self._forks = forks
        self.future: Future[Any] | None = None
        self._tasks: SimpleQueue[_Task | None] = SimpleQueue()
        self._child: _Child | None = None
        self._stopped = False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def free(self) -> bool:
        """Whether a task would be begun at once."""
        return self.future is None or self.future.done()

    def start(self) -> None:
        """Start the process before there is a task."""
        self._tasks.put(_Task(b"", _START_S, Future()))

    def submit(self, function: Callable[..., T], argument: Any, timeout_s: float) -> Future[T]:
        """Run `function(argument)`; TimeoutError or WorkerDied when there is no answer."""
        future: Future[T] = Future()
        future.set_running_or_notify_cancel()
        self.future = future
        try:
            request = pickle.dumps((function, argument))
        except Exception as error:
            future.set_exception(error)
        else:
            self._tasks.put(_Task(request, timeout_s, future))
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
        _hold_interrupts()
        while (task := self._tasks.get()) is not None:
            try:
                if self._stopped:
                    raise WorkerDied("it was stopped")
                answer = self._answer(task)
            except BaseException as error:
                task.future.set_exception(error)
            else:
                task.future.set_result(answer)
            self._recycle()
        if self._child:
            self._child.kill()
            self._child.end()

    def _answer(self, task: _Task) -> Any:
        if self._child is None or not self._child.alive:
            self._child = _Child(self._forks)
        if self._stopped:  # while it was being started
            self._child.kill()
        return self._child.ask(task.request, task.timeout_s) if task.request else None

    def _recycle(self) -> None:
        child = self._child
        if child and (not child.alive or child.answered == self.pool.tasks_per_worker > 0):
            self._child = None
            child.end()


class _Child:
    """A worker process and our end of the connection to it."""

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
        _children.add(self)

    @property
    def alive(self) -> bool:
        return not self._connection.closed and self._process.is_alive()

    def kill(self) -> None:
        with suppress(ValueError, OSError):  # gone already
            self._process.kill()

    def ask(self, request: bytes, timeout_s: float) -> Any:
        """What the task returns, or raises.  TimeoutError or WorkerDied: the process is gone."""
        with self._killed_after(_START_S) as late:
            try:
                self._connection.send_bytes(request)
                answer = self._received()
            except (EOFError, OSError):
                why = f"it had begun nothing after {_START_S:g} s" if late.is_set() else ""
                raise WorkerDied(why or _exit_text(self.end())) from None
        if answer == _BEGUN:
            with self._killed_after(timeout_s) as late:
                try:
                    answer = self._received()
                except (EOFError, OSError):
                    died = WorkerDied(_exit_text(self.end()))
                    raise TimeoutError() if late.is_set() else died from None
        self.answered += 1
        good, result = pickle.loads(answer)
        if good:
            return result
        raise result

    def _received(self) -> bytes:
        # A copy of its end may live on in a process that something else here has forked.
        while not self._connection.poll(_LOOK_S):
            if not self._process.is_alive() and not self._connection.poll():
                raise EOFError
        return self._connection.recv_bytes()

    @contextmanager
    def _killed_after(self, seconds: float) -> Iterator[threading.Event]:
        late = threading.Event()

        def kill() -> None:
            late.set()
            self.kill()

        timer = threading.Timer(seconds, kill)
        timer.daemon = True
        timer.start()
        try:
            yield late
        finally:
            timer.cancel()

    def end(self) -> int | None:
        """Let the process end; its exit code, None when even a kill did not end it."""
        self._connection.close()
        self._process.join(_END_S)
        self.kill()
        self._process.join(_END_S)
        return self._process.exitcode


# At its end, multiprocessing would wait for all that live.
_children: weakref.WeakSet[_Child] = weakref.WeakSet()


@atexit.register
def _kill_children() -> None:
    for child in list(_children):
        child.kill()


def _hold_interrupts() -> None:
    """Keep Ctrl-C from this thread and the processes that it starts: only the main one answers it.

    It goes to the whole process group of a terminal.
    """
    if hasattr(signal, "pthread_sigmask"):
        # Its start would lift the hold, so it has to run before.
        resource_tracker.ensure_running()
        signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _work(connection: Connection, environment: dict[str, str]) -> None:
    """What the process does until its connection is closed.

    environment: of the parent as it is now; a template may have been started with another.
    """
    os.environ.clear()
    os.environ.update(environment)
    start_worker_process()
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    while True:
        try:
            request = connection.recv_bytes()
        except EOFError:
            return
        try:
            function, argument = pickle.loads(request)
            connection.send_bytes(_BEGUN)
            answer = pickle.dumps((True, function(argument)))
        except BaseException as error:
            answer = _pickled(error)
        connection.send_bytes(answer)


def _pickled(error: BaseException) -> bytes:
    """The error with its traceback as a note, or its text when it cannot be sent."""
    told = "".join(traceback.format_exception(error))
    with suppress(Exception):
        error.add_note(told)
        answer = pickle.dumps((False, error))
        pickle.loads(answer)
        return answer
    return pickle.dumps((False, RuntimeError(told)))


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


def stop_all(slots: list[Slot], within_s: float) -> None:
    """Stop slots together, and wait so long at most until all are gone."""
    for slot in slots:
        slot.stop()
    deadline = time.monotonic() + within_s
    for slot in slots:
        while not slot.join(min(0.05, max(0.0, deadline - time.monotonic()))):
            # One may have been starting its process at that very moment.
            slot.kill()
            if time.monotonic() > deadline:
                break
