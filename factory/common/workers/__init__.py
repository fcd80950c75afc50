"""Runs tasks in processes, or without any, behind one interface.

A task is an importable function and one argument that pickles.  Nothing here knows what tasks do.
"""

from __future__ import annotations

import pickle
import signal
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, NamedTuple

from .machine import keep_freed_memory

Hear = Callable[[Any], None]

RESULT = "result"
ERROR = "error"

# Who listens to the task of this process.
_listeners: list[Hear] = []


class WorkerDied(Exception):
    """The worker of a task ended, or had to be ended, before it answered."""


class Pool(NamedTuple):
    """A number of workers that take the same kinds of tasks.

    kinds: of tasks that they run; for the first kind they are taken before others.
    workers: how many processes; may be 0.
    tasks_per_worker: a process is replaced after this many tasks; 0: never.
    """

    kinds: tuple[str, ...]
    workers: int
    tasks_per_worker: int = 0


class Task(NamedTuple):
    """`function(argument)`, for workers that run tasks of this kind.

    silence_s: longest time between two things that it tells (`tell`); a worker that says nothing
        for longer is killed.
    hear: called with what it tells, from any thread.
    """

    function: Callable[[Any], Any]
    argument: Any
    kind: str
    silence_s: float
    hear: Hear = lambda message: None

    def request(self) -> bytes:
        """What `answered` takes."""
        return pickle.dumps((self.function, self.argument))


class Backend:
    """Runs tasks in this process, for debuggers and profilers; subclasses run them in others.

    Here limits of time are not kept, and a crash ends everything.  Whether and when to try again is
    up to whoever submits.
    """

    def __init__(self) -> None:
        keep_freed_memory()

    def free(self, kind: str) -> bool:
        """Whether a task of this kind would start at once."""
        return True

    def submit(self, task: Task) -> Future[Any]:
        """Run it: its result, its error, TimeoutError of a silent worker, WorkerDied of a dead."""
        future: Future[Any] = Future()
        _listeners[:] = [task.hear]
        try:
            future.set_result(task.function(task.argument))
        except Exception as error:
            future.set_exception(error)
        finally:
            _listeners.clear()
        return future

    def close(self) -> None:
        """Stop all workers now, whatever they are doing."""


def start_worker_process(worker: Any = None) -> None:
    """Leave Ctrl-C, which goes to every process of a terminal, to the parent; set up malloc."""
    with suppress(ValueError):  # not in the main thread: no signal would be delivered here
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    keep_freed_memory()


# Called by Dask in every new worker process, which has this module as its `--preload`.
dask_setup = start_worker_process


def tell(*message: int | None) -> None:
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
