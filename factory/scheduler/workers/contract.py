"""What runs tasks in other processes: the contract that every backend keeps.

A task is an importable function and one argument that pickles.  Nothing here knows what tasks do.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar

from .start import Hear

T = TypeVar("T")

BackendName = Literal["local", "serial", "dask"]


@dataclass(frozen=True)
class Pool:
    """Workers of one kind.

    workers: how many processes; may be 0.
    also_takes: names of other pools whose tasks they run when they have none of their own.
    tasks_per_worker: a process is replaced after so many tasks (local workers only); 0: never.
    """

    name: str
    workers: int
    also_takes: tuple[str, ...] = ()
    tasks_per_worker: int = 0

    def takes(self, pool: str) -> bool:
        """Whether its workers run tasks that are submitted to `pool`."""
        return pool == self.name or pool in self.also_takes


@dataclass(frozen=True)
class WorkerSettings:
    """Which processes run the tasks.

    threads: of each worker's numerical libraries.
    start_all: start every worker at once, not when there is a task for it.
    address: of a Dask scheduler, tcp://host:port; None starts a cluster on this machine.
    preload: modules that every worker needs, loaded once for all (local workers only).
    """

    pools: tuple[Pool, ...]
    backend: BackendName = "local"
    threads: int = 1
    start_all: bool = False
    address: str | None = None
    preload: tuple[str, ...] = ()

    @property
    def total(self) -> int:
        """All workers."""
        return sum(pool.workers for pool in self.pools)


class Backend(Protocol):
    """Runs tasks somewhere else.  Whether and when to try again is up to whoever submits them."""

    def free(self, pool: str) -> bool:
        """Whether a task of this pool would start at once."""

    def submit(
        self,
        function: Callable[..., T],
        argument: Any,
        silence_s: float,
        pool: str,
        hear: Hear | None = None,
    ) -> Future[T]:
        """Run `function(argument)`.

        silence_s: longest time between two things that the task tells (`start.tell`); a worker
            that says nothing for longer is killed, and the future has a TimeoutError.
        hear: called with what the task tells, from any thread.
        """

    def why_died(self, error: BaseException) -> str | None:
        """What killed the worker, if that is what `error` of a future means; else None."""

    def poll(self) -> None:
        """To be called several times a second."""

    def stop(self) -> None:
        """Stop all workers now, whatever they are doing."""


def open_backend(settings: WorkerSettings) -> Backend:
    """The backend that `settings.backend` names.  Raises FactoryError when it cannot be had."""
    if settings.backend == "serial":
        from .serial import SerialBackend

        return SerialBackend()
    if settings.backend == "dask":
        # Half a second of imports, and an optional dependency.
        from .dask_cluster import DaskBackend

        return DaskBackend(settings)
    from .local import LocalBackend

    return LocalBackend(settings)
