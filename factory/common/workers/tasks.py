"""A list of independent tasks on worker processes: a process that dies costs its task alone."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Self, TypeVar

from . import Backend, Pool, Task, WorkerDied
from .local import LocalBackend
from .machine import usable_cores

T = TypeVar("T")
R = TypeVar("R")

_TASK = "task"


@dataclass(frozen=True)
class TaskLost:
    """Stands in place of a result when the worker died or took too long."""

    reason: str


class TaskPool:
    """Worker processes on this machine, started when there is work; leaving the `with` stops them.

    workers: how many; auto is one per core.  1 works in this process, where a crash ends everything
        and time is not limited.
    """

    def __init__(self, workers: int | Literal["auto"]) -> None:
        self._workers = workers

    @cached_property
    def _backend(self) -> Backend:
        if self._workers == 1:
            return Backend()
        workers = usable_cores() if self._workers == "auto" else self._workers
        return LocalBackend((Pool((_TASK,), workers),))

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if "_backend" in vars(self):
            self._backend.close()
            del self._backend

    def run(
        self, function: Callable[[T], R], waiting: deque[T], timeout_s: Callable[[T], float]
    ) -> Iterator[tuple[T, R | TaskLost]]:
        """(task, `function(task)`) of each waiting task, as they are done.

        function: importable, because worker processes call it.
        waiting: emptied; the caller may change it between results.
        timeout_s: how long a task may take.
        Exceptions of `function` are raised here.
        """
        running: dict[Future[R], T] = {}
        while waiting or running:
            # Each result is taken before more begins: in this process all would be done first.
            while waiting and self._backend.free(_TASK) and not any(map(Future.done, running)):
                task = waiting.popleft()
                sent = Task(function, task, _TASK, timeout_s(task))
                running[self._backend.submit(sent)] = task
            done, _ = wait(running, return_when=FIRST_COMPLETED)
            for future in done:
                task = running.pop(future)
                result: R | TaskLost
                try:
                    result = future.result()
                except TimeoutError:
                    result = TaskLost(f"took longer than {timeout_s(task):g} s")
                except WorkerDied as died:
                    result = TaskLost(str(died))
                yield task, result
