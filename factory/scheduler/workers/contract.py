"""What runs tasks in other processes: the contract that every backend keeps.

A task is an importable function and one argument that pickles.  Nothing here knows what tasks do.
"""

from __future__ import annotations

import pickle
import signal
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar

from .machine import keep_freed_memory

T = TypeVar("T")

BackendName = Literal["local", "serial", "dask"]
Hear = Callable[[Any], None]

RESULT, ERROR = "result", "error"

# Who listens to the task of this process.
_listeners: list[Hear] = []


def start_worker_process() -> None:
    """Leave Ctrl-C, which goes to every process of a terminal, to the parent; set up malloc."""
    with suppress(ValueError):  # not in the main thread: no signal would be delivered here
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()


def tell(*message: str | int) -> None:
    """Say how far the task is, to whoever submitted it; arrived when this returns."""
    for hear in _listeners:
        hear(message)


def answered(request: bytes, say: Hear) -> bytes:
    """What a worker answers to a pickled (function, argument): a pickled (RESULT or ERROR, value).

    say: takes `()` when the task begins, and what it tells.  An error has its traceback as a note;
    one that does not survive the way is a RuntimeError with that as its text.
    """
    try:
        function, argument = pickle.loads(request)
        say(())
        _listeners[:] = [say]
        return pickle.dumps((RESULT, function(argument)))
    except BaseException as error:
        trace = "".join(traceback.format_exception(error))
        with suppress(Exception):
            error.add_note(trace)
            answer = pickle.dumps((ERROR, error))
            pickle.loads(answer)
            return answer
        return pickle.dumps((ERROR, RuntimeError(trace)))
    finally:
        _listeners.clear()


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

    address: of a Dask scheduler, tcp://host:port; None starts a cluster on this machine.
    preload: modules that every worker needs, loaded once for all (local workers only).
    """

    pools: tuple[Pool, ...]
    backend: BackendName = "local"
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
        function: Callable[[Any], T],
        argument: Any,
        silence_s: float,
        pool: str,
        hear: Hear | None = None,
    ) -> Future[T]:
        """Run `function(argument)`.

        silence_s: longest time between two things that the task tells (`tell`); a worker that says
            nothing for longer is killed, and the future has a TimeoutError.
        hear: called with what the task tells, from any thread.
        """

    def why_died(self, error: BaseException) -> str | None:
        """What killed the worker, if that is what `error` of a future means; else None."""

    def poll(self) -> None:
        """To be called several times a second."""

    def stop(self) -> None:
        """Stop all workers now, whatever they are doing."""


class SerialBackend:
    """A `Backend` in this process, whose tasks are done when they have been submitted.

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
        function: Callable[[Any], T],
        argument: Any,
        silence_s: float,
        pool: str,
        hear: Hear | None = None,
    ) -> Future[T]:
        """Run it here and now."""
        self._full = True
        future: Future[T] = Future()
        _listeners[:] = [hear] if hear else []
        try:
            future.set_result(function(argument))
        except Exception as error:
            future.set_exception(error)
        finally:
            _listeners.clear()
        return future

    def why_died(self, error: BaseException) -> str | None:
        """There is no worker that could die."""
        return None

    def poll(self) -> None:
        """Results have been taken: the next task may run."""
        self._full = False

    def stop(self) -> None:
        """Nothing to stop."""


def dask_setup(worker: Any) -> None:
    """Called by Dask in every new worker process, which has this module as its `--preload`."""
    start_worker_process()
