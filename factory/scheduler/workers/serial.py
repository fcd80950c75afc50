"""No worker processes: tasks run in this process, one at a time."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import Any, TypeVar

from .memory import keep_freed_memory
from .start import Hear, heard_by

T = TypeVar("T")


class SerialBackend:
    """A `contract.Backend` whose tasks are done when they have been submitted.

    For debuggers and profilers.  Time limits are not kept, and a crash ends everything.
    """

    def __init__(self) -> None:
        keep_freed_memory()
        self._full = False

    def free(self, pool: str) -> bool:
        """Once between two polls, so that each result is on record before the next task."""
        return not self._full

    def submit(
        self,
        function: Callable[..., T],
        argument: Any,
        silence_s: float,
        pool: str,
        hear: Hear | None = None,
    ) -> Future[T]:
        """Run it here and now."""
        self._full = True
        future: Future[T] = Future()
        try:
            with heard_by(hear):
                future.set_result(function(argument))
        except Exception as error:
            future.set_exception(error)
        return future

    def why_died(self, error: BaseException) -> str | None:
        """There is no worker that could die."""
        return None

    def poll(self) -> None:
        """Results have been taken: the next task may run."""
        self._full = False

    def stop(self) -> None:
        """Nothing to stop."""
