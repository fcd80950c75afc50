"""The seam between the run loop and whatever runs its tasks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from typing import Any, Protocol, TypeVar

from simnfnd.factory.jobs.settings import Crew, Kind, SchedulerSettings

T = TypeVar("T")


class Backend(Protocol):
    """Runs tasks somewhere else.  What is retried, and when, is the run loop's business alone."""

    def free(self, kind: Kind) -> bool:
        """Whether a task of this kind would be begun at once."""

    def submit(
        self, function: Callable[..., T], argument: Any, timeout_s: float, kind: Kind
    ) -> Future[T]:
        """Run `function(argument)`; a future with TimeoutError when that takes longer."""

    def why_died(self, error: BaseException) -> str | None:
        """What killed the worker, if that is what `error` of a future means; else None."""

    def poll(self) -> None:
        """Called several times a second."""

    def stop(self) -> None:
        """Stop all workers now, whatever they do."""


def open_backend(
    settings: SchedulerSettings, crew: Crew, tasks_per_worker: Mapping[Kind, int]
) -> Backend:
    """The backend that `settings.backend` names.

    tasks_per_worker: after so many a worker process is replaced (local workers alone).
    Raises FactoryError when it cannot be had.
    """
    if settings.backend == "serial":
        return SerialBackend()
    if settings.backend == "dask":
        # Half a second of imports, and an extra that not everybody has.
        from simnfnd.factory.workers.dask_cluster import DaskBackend

        return DaskBackend(settings, crew)
    from simnfnd.factory.workers.local import LocalBackend

    return LocalBackend(crew, tasks_per_worker, settings.threads, settings.start_all)


class SerialBackend:
    """No worker at all: a task is done when it has been submitted.

    For debuggers and profilers.  Time limits are not kept, and a crash is the end of the run.
    """

    def __init__(self) -> None:
        self._full = False

    def free(self, kind: Kind) -> bool:
        """For one task at a time: what is done is to be on record before the next begins."""
        return not self._full

    def submit(
        self, function: Callable[..., T], argument: Any, timeout_s: float, kind: Kind
    ) -> Future[T]:
        """Run it here and now."""
        self._full = True
        future: Future[T] = Future()
        try:
            future.set_result(function(argument))
        except Exception as error:
            future.set_exception(error)
        return future

    def why_died(self, error: BaseException) -> str | None:
        """Nobody can."""
        return None

    def poll(self) -> None:
        """The loop has seen the result."""
        self._full = False

    def stop(self) -> None:
        """Nothing to stop."""
