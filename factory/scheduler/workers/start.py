"""What every worker process does first, and how a task says how far it is."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from .memory import keep_freed_memory

Hear = Callable[[Any], None]

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


@contextmanager
def heard_by(hear: Hear | None) -> Iterator[None]:
    """Within the block, what the task of this process tells goes to `hear`."""
    _listeners[:] = [hear] if hear else []
    try:
        yield
    finally:
        _listeners.clear()
