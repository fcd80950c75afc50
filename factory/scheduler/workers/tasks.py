"""A list of independent tasks on worker processes: a process that dies costs its task alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from typing import Literal, Self, TypeVar

from .contract import Backend, Pool, SerialBackend, WorkerSettings
from .local import LocalBackend
from .machine import usable_cores

T = TypeVar("T")
R = TypeVar("R")

_POOL = "tasks"


@dataclass(frozen=True)
class TaskLost:
    """In place of a result: the worker died or took too long."""

    reason: str


class TaskPool:
    """Worker processes on this machine, started when there is work; leaving the `with` stops them.

    workers: how many; auto is one a core.  1 works in this process, where a crash ends everything
        and time is not limited.
    """

    def __init__(self, workers: int | Literal["auto"]) -> None:
        self._workers = usable_cores() if workers == "auto" else workers
        self._in_process = workers == 1
        self._backend: Backend | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._backend is not None:
            self._backend.stop()
            self._backend = None

    def run(
        self, function: Callable[[T], R], waiting: deque[T], timeout_s: Callable[[T], float]
    ) -> Iterator[tuple[T, R | TaskLost]]:
        """(task, `function(task)`) of each waiting task, as they are done.

        function: importable, because worker processes call it.
        waiting: emptied; the caller may change it between results.
        timeout_s: how long a task may take.
        Exceptions of `function` are raised here.
        """
        if self._backend is None:
            settings = WorkerSettings((Pool(_POOL, self._workers),))
            self._backend = SerialBackend() if self._in_process else LocalBackend(settings)
        backend = self._backend
        running: dict[Future[R], T] = {}
        while waiting or running:
            while waiting and backend.free(_POOL):
                task = waiting.popleft()
                running[backend.submit(function, task, timeout_s(task), _POOL)] = task
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                result = _result(future, backend, timeout_s(task))
                yield task, result
            backend.poll()


def _result(future: Future[R], backend: Backend, timeout_s: float) -> R | TaskLost:
    try:
        return future.result()
    except TimeoutError:
        return TaskLost(f"took longer than {timeout_s:g} s")
    except Exception as error:
        reason = backend.why_died(error)
        if reason is None:
            raise
        return TaskLost(reason)
