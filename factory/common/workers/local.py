"""Worker processes on this machine: single-threaded, replaceable, and ended with this process.

Every wait here ends: each worker has one deadline, put off by all that it tells, and one thread
kills whoever misses it.  What was said to a process that is dead fails at once, because the two
share a pair of sockets that no other process has.
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
from concurrent.futures import Future
from contextlib import ExitStack, closing, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any

import psutil

from . import ERROR, Backend, Pool, Task, WorkerDied, answered, start_worker_process, template

_BEGIN_S = 60.0  # most time for a process to start, and for a further task to begin
FIRST_S = 300.0  # most time for its first task to begin: the process imports what it needs
END_S = 5.0  # most time for killed processes to exit
LOOK_S = 0.5  # time between two looks for processes that are late or dead
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
        self._workers = [
            _Worker(pool, bool(preload)) for pool in pools for _ in range(pool.workers)
        ]
        self._stopped = threading.Event()
        threading.Thread(target=self._watch, daemon=True).start()

    def _watch(self) -> None:
        while not self._stopped.wait(LOOK_S):
            for worker in tuple(self._workers):
                worker.kill_if_late()

    def free(self, kind: str) -> bool:
        """Whether a worker waits for a task of this kind."""
        return any(worker.takes(kind) for worker in self._workers)

    def submit(self, task: Task) -> Future[Any]:
        """Give the task to a free worker, best to one whose first kind it is."""
        free_workers = (worker for worker in self._workers if worker.takes(task.kind))
        worker = min(free_workers, key=lambda worker: worker.pool.kinds[0] != task.kind)
        # The worker goes to the end of the line, so that all get their share of the work.
        self._workers.remove(worker)
        self._workers.append(worker)
        return worker.begin(task)

    def close(self) -> None:
        """Kill the workers now."""
        self._stopped.set()
        deadline = time.monotonic() + END_S
        # A worker that is starting its process at this moment cannot be closed yet.
        open_workers = [worker for worker in self._workers if not worker.close()]
        while open_workers and time.monotonic() < deadline:
            time.sleep(0.01)
            open_workers = [worker for worker in open_workers if not worker.close()]
        self._block.close()


class _Worker:
    """A place for one process at a time; each task is a talk with it, in a thread of its own.

    The process is no fork of this one, which may have rendered and does not survive a fork.
    Whether it lives is not asked of `multiprocessing`: once the template is dead, that takes every
    fork of it for dead and kills none.
    """

    _connection: Connection
    _started: BaseProcess

    def __init__(self, pool: Pool, forks: bool) -> None:
        """forks: start processes as forks of the template where there is one."""
        self.pool = pool
        self._forks = forks
        self._future: Future[Any] | None = None
        self._talking = threading.Lock()
        self._process: psutil.Process | None = None
        self._answered = 0
        self._deadline = math.inf
        self._stopped = False

    def takes(self, kind: str) -> bool:
        """Whether a task of this kind would be begun at once."""
        return kind in self.pool.kinds and (self._future is None or self._future.done())

    def begin(self, task: Task) -> Future[Any]:
        """Begin the task in a thread of its own; returns its future result."""
        self._future = Future()
        arguments = (self._future, task.request(), task)
        threading.Thread(target=self._talk, args=arguments, daemon=True).start()
        return self._future

    def _talk(self, future: Future[Any], request: bytes, task: Task) -> None:
        # Only the main thread answers Ctrl-C, and no process that this one starts.
        template.hold_interrupts()
        with self._talking:
            try:
                kind, value = self._answer(request, task)
                if kind == ERROR:
                    raise value
                future.set_result(value)
            except BaseException as error:
                future.set_exception(error)
            finally:
                self._deadline = math.inf

    def _answer(self, request: bytes, task: Task) -> tuple[str, Any]:
        """Kind and value of the answer to a task.

        Raises TimeoutError when the task was silent for too long, and WorkerDied when its process
        ended.
        """
        limit = self.pool.tasks_per_worker  # 0: no limit
        is_used_up = limit > 0 and self._answered == limit
        if self._process and (is_used_up or not self._runs()):
            self._end()
        if self._process is None:
            self._start()
        self._deadline = time.monotonic() + (_BEGIN_S if self._answered else FIRST_S)
        begun = False
        if self._stopped:  # while it was being started
            _kill(self._process)
        try:
            self._connection.send_bytes(request)
            while True:
                kind, value = self._received()
                if kind != _NEWS:
                    self._answered += 1
                    return kind, value
                self._deadline = time.monotonic() + task.silence_s
                begun = True
                if value:
                    task.hear(value)
        except (EOFError, OSError):
            late = time.monotonic() >= self._deadline
            exitcode = self._end(0 if late else END_S)
            if late and begun:
                raise TimeoutError from None
            reason = "it did not respond before it had begun" if late else _exit_text(exitcode)
            raise WorkerDied(reason) from None

    def _start(self) -> None:
        self._answered = 0
        self._deadline = time.monotonic() + _BEGIN_S
        self._connection, theirs = multiprocessing.Pipe()
        with closing(theirs):  # so that its end of the connection ends with it
            self._started = template.started(self._forks, _work, (theirs, dict(os.environ)))
        with suppress(psutil.NoSuchProcess):  # has exited already
            self._process = psutil.Process(self._started.pid)
        # At its end, multiprocessing would wait for all that live.
        weakref.finalize(self, _kill, self._process)

    def _runs(self) -> bool:
        with suppress(psutil.Error):
            if self._process and self._process.is_running():
                return self._process.status() != psutil.STATUS_ZOMBIE
        return False

    def _received(self) -> tuple[str, Any]:
        """The next message of the process.  Raises EOFError or OSError when it has exited."""
        # A copy of its end may live on in a process that something else here has forked.
        while not self._connection.poll(LOOK_S):
            if not self._runs() and not self._connection.poll():
                raise EOFError
        kind, value = pickle.loads(self._connection.recv_bytes())
        return kind, value

    def _end(self, patience_s: float = 0) -> int | None:
        """Kill the process if it does not end within the time; returns its exit code.

        None: it did not end even then.
        """
        self._deadline = math.inf
        self._connection.close()
        for wait_s in (patience_s, END_S):
            end = time.monotonic() + wait_s
            while self._runs() and time.monotonic() < end:
                time.sleep(0.01)
            _kill(self._process)
        self._started.join(0 if self._runs() else LOOK_S)
        self._process = None
        return self._started.exitcode

    def kill_if_late(self) -> None:
        """Kill what keeps the task waiting, once it does so for too long."""
        process = self._process
        if time.monotonic() > self._deadline:
            _kill(process) if process else template.kill()

    def close(self) -> bool:
        """Kill the process and start no other; returns whether it has ended."""
        self._stopped = True
        _kill(self._process)
        if not self._talking.acquire(blocking=False):
            return False
        if self._process:
            self._end()
        return True


def _kill(process: psutil.Process | None) -> None:
    with suppress(psutil.Error):  # has exited already
        if process:
            process.kill()


def _work(connection: Connection, environment: dict[str, str]) -> None:
    """Answer tasks until the connection is closed, in the environment that the parent has now."""
    os.environ.clear()
    os.environ.update(environment)
    start_worker_process()
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    # Closed while we work: no process waits for the result.
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
    name = signal.Signals(-exitcode).name
    hint = ", perhaps for want of memory" if name == "SIGKILL" else ""
    return f"native crash, its worker process was killed by {name}{hint}"
