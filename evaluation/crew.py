"""Tasks on worker processes that may die: a death costs the task in hand, never the run."""

from __future__ import annotations

import concurrent.futures
import os
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Self, TypeVar

from simnfnd.factory.jobs.settings import Crew, usable_cores
from simnfnd.factory.workers.local import LocalBackend

T = TypeVar("T")
R = TypeVar("R")

# Pictures are megabytes: by default glibc gives each back to the system, and half of the time of
# the metrics goes into getting fresh pages.  Read when a process starts; unknown elsewhere.
_KEEP_MEMORY = {
    "MALLOC_MMAP_THRESHOLD_": "1000000000",
    "MALLOC_TRIM_THRESHOLD_": "2000000000",
    "MALLOC_TOP_PAD_": "100000000",
}
_TASKS_PER_WORKER = 1_000_000  # nothing here leaks, so no worker need be replaced


@dataclass(frozen=True)
class Died:
    """Instead of a result: the worker died or took too long, and why."""

    why: str


class Team:
    """The worker processes of a whole report, started when there is work for them.

    workers: how many; `auto` is one a core, and 1 works in this process, where a crash is the end
    and time is not limited.  Leaving the `with` stops them.
    """

    def __init__(self, workers: int | str) -> None:
        self._count = usable_cores() if workers == "auto" else int(workers)
        self._alone = workers == 1
        self._backend: LocalBackend | None = None
        self._added: list[str] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._backend is not None:
            self._backend.stop()
            self._backend = None
        for name in self._added:
            os.environ.pop(name, None)

    def run(
        self, work: Callable[[T], R], waiting: deque[T], timeout_s: Callable[[T], float]
    ) -> Iterator[tuple[T, R | Died]]:
        """(task, its result) of each waiting task, as they come.

        The caller may change `waiting` between results.  timeout_s: of a task.  Exceptions of
        `work` are raised here.
        """
        if self._alone:
            while waiting:
                task = waiting.popleft()
                yield task, work(task)
            return
        if self._backend is None:
            self._added = [name for name in _KEEP_MEMORY if name not in os.environ]
            os.environ.update({name: _KEEP_MEMORY[name] for name in self._added})
            crew = Crew(render=0, noise=self._count)
            self._backend = LocalBackend(crew, {"noise": _TASKS_PER_WORKER, "render": 1}, 1, False)
        backend = self._backend
        running: dict[concurrent.futures.Future[Any], T] = {}
        while waiting or running:
            while waiting and backend.free("noise"):
                task = waiting.popleft()
                running[backend.submit(work, task, timeout_s(task), "noise")] = task
            done, _ = concurrent.futures.wait(
                running, return_when=concurrent.futures.FIRST_COMPLETED
            )
            for future in done:
                task = running.pop(future)
                yield task, _outcome(future, backend, timeout_s(task))


def _outcome(
    future: concurrent.futures.Future[R], backend: LocalBackend, timeout_s: float
) -> R | Died:
    try:
        return future.result()
    except TimeoutError:
        return Died(f"took longer than {timeout_s:g} s")
    except Exception as error:
        why = backend.why_died(error)
        if why is None:
            raise
        return Died(why)
