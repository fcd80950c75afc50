"""Worker processes on this machine: single-threaded, replaceable, gone when we go."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from . import template
from .contract import WorkerSettings
from .slot import Slot, WorkerDied, stop_all

T = TypeVar("T")

_STOP_S = 10.0


class LocalBackend:
    """Worker processes on this machine; a `contract.Backend`.

    Whatever kills a worker costs the task it had in hand, and nothing else.
    """

    def __init__(self, settings: WorkerSettings) -> None:
        # Read when a library is loaded, so set before a worker exists; recycled ones read it too.
        self._saved = template.tell(settings.threads)
        template.start(settings.preload, settings.threads)
        forks = bool(settings.preload)
        self._slots = [Slot(pool, forks) for pool in settings.pools for _ in range(pool.workers)]
        if settings.start_all:
            for slot in self._slots:
                slot.start()

    def free(self, pool: str) -> bool:
        """Whether a worker waits for a task of this pool."""
        return any(slot.free and slot.pool.takes(pool) for slot in self._slots)

    def submit(
        self, function: Callable[..., T], argument: Any, timeout_s: float, pool: str
    ) -> Future[T]:
        """Run `function(argument)` in a free worker; it is killed when it takes longer."""
        fit = (slot for slot in self._slots if slot.free and slot.pool.takes(pool))
        slot = min(fit, key=lambda slot: slot.pool.name != pool)
        # To the end of the line, so that all get their share of the work.
        self._slots.remove(slot)
        self._slots.append(slot)
        return slot.submit(function, argument, timeout_s)

    def expire(self, future: Future[Any]) -> None:
        """Kill the worker that has the task in hand."""
        for slot in self._slots:
            if slot.future is future and not future.done():
                slot.kill()

    def poll(self) -> None:
        """Nothing: each worker's own thread watches its time limit."""

    def why_died(self, error: BaseException) -> str | None:
        """What killed the worker, if that is what `error` of a future means; else None."""
        return str(error) if isinstance(error, WorkerDied) else None

    def stop(self) -> None:
        """Kill the workers now; files are whole or absent if tasks write them atomically."""
        stop_all(self._slots, _STOP_S)
        template.restore(self._saved)
