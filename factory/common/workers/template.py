"""The process that workers are forked from, which has loaded once what each of them needs.

To start an interpreter and to load numpy, numba and the loops costs a worker more than a second; a
fork of a process that has them costs some milliseconds, and shares their memory.  It is the fork
server of `multiprocessing`, which runs one thread and neither renders nor makes a pair, so that
what is forked from it is as good as new.  Where there is none (outside Linux, or when it
died), workers are spawned.
"""

from __future__ import annotations

import atexit
import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import forkserver, resource_tracker
from multiprocessing.process import BaseProcess
from types import ModuleType
from typing import Any

from ..private_apis import children_allowed, fork_server_pid, kill_fork_server

THREAD_VARIABLES = (
    *(f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA", "NUMEXPR")),
    *("VECLIB_MAXIMUM_THREADS", "OPENCV_FOR_THREADS_NUM"),
)

# The process that started one; whoever is forked from that has none.
_owner: int | None = None


def start(modules: tuple[str, ...]) -> None:
    """Start the template, unless it runs; returns at once, while it imports the modules.

    Without modules there is nothing to share, and none is started.
    """
    if not modules or runs() or sys.platform != "linux" or _has_foreign_server():
        return
    global _owner
    held = hold_interrupts()
    forkserver.set_forkserver_preload(list(modules))
    # In a forked process the fork server belongs to the parent, and this raises.
    with one_thread(), suppress(ChildProcessError):
        forkserver.ensure_running()
        _owner = os.getpid()
    signal.pthread_sigmask(signal.SIG_SETMASK, held)


def started(forks: bool, target: Callable[..., None], arguments: tuple[Any, ...]) -> BaseProcess:
    """A process that runs `target(*arguments)`: if it `forks`, a fork of the template.

    Where no template runs, or it dies or hangs meanwhile, the process is spawned.
    """
    process: BaseProcess
    with _main_module_hidden(), children_allowed():
        if forks and runs():
            context = multiprocessing.get_context("forkserver")
            process = context.Process(target=target, args=arguments)
            # It may die meanwhile, or there is no room for a process at all.
            with suppress(EOFError, OSError):
                process.start()
                return process
        process = multiprocessing.get_context("spawn").Process(target=target, args=arguments)
        process.start()
        return process


_hiding = threading.Lock()


@contextmanager
def _main_module_hidden() -> Iterator[None]:
    """Keep `multiprocessing` from importing the user's script in the new process.

    A script that makes a dataset would begin again in each worker.
    """
    with _hiding:
        main = sys.modules.get("__main__")
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            yield
        finally:
            if main is not None:
                sys.modules["__main__"] = main


def runs() -> bool:
    """Whether this process has started the template."""
    return _owner == os.getpid()


def _has_foreign_server() -> bool:
    """Whether the program that uses this one as a library has a fork server of its own."""
    return fork_server_pid() is not None


@atexit.register
def kill() -> None:
    """Kill the template, if there is one; what was forked from it lives on."""
    global _owner
    if not runs():
        return
    # The next `start` may then start another.
    _owner = None
    kill_fork_server()


@contextmanager
def one_thread() -> Iterator[None]:
    """Let libraries of processes that are started within the block use one thread."""
    saved = {name: os.environ.pop(name, None) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name in THREAD_VARIABLES:
            os.environ.pop(name, None)
        os.environ.update({name: value for name, value in saved.items() if value is not None})


def hold_interrupts() -> set[int]:
    """Keep Ctrl-C, which a terminal sends to all its processes, from this thread and its children.

    Returns the signals that were held before.
    """
    # The resource tracker lifts the hold when it starts, so it has to run before.
    resource_tracker.ensure_running()
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}))
