"""Ctrl-C and SIGTERM: one exception that unwinds the run, so that every `finally` does its part."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_ONE_KEYPRESS_S = 0.3


class Interrupted(KeyboardInterrupt):
    """The run was told to stop.  `exit_code` is what a shell expects: 130 or 143."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.exit_code = 128 + number


@contextmanager
def stop_signals() -> Iterator[None]:
    """Within the block the first SIGINT or SIGTERM raises Interrupted; a second ends it all.

    Stopping takes about a second.  After a second signal workers notice that their parent is gone,
    and the next run removes what is left behind.  Both signals of one keypress (a shell's and a
    terminal's) count as one.  In a thread that is not the main one, where Python delivers no
    signals, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    first: list[float] = []

    def handle(number: int, _: FrameType | None) -> None:
        if not first:
            first.append(time.monotonic())
            raise Interrupted(number)
        if time.monotonic() - first[0] > _ONE_KEYPRESS_S:
            os._exit(128 + number)

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        for number in before:
            signal.signal(number, handle)
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
