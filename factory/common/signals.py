"""Ctrl-C and SIGTERM: one exception that unwinds the run, so that every `finally` does its part."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_ONE_KEYPRESS_S = 0.3
_ASK_AGAIN_S = 0.01


class Interrupted(KeyboardInterrupt):
    """The command was told to stop.

    exit_code: what a shell expects, 130 or 143.
    kept: what the line on stderr says of the work; who catches it may set it and raise it again.
    """

    kept = ""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.exit_code = 128 + number


@contextmanager
def stop_signals() -> Iterator[None]:
    """Within the block the first SIGINT or SIGTERM raises Interrupted; a second ends it all.

    After a second signal workers notice that their parent has exited, and the next run removes what
    is left behind.  Both signals of one keypress (a shell's and a terminal's) count as one.  In a
    thread that is not the main one, where Python delivers no signals, nothing is changed.

    Python throws away what is raised in the callback of a weak reference, and h5py has thousands of
    them while it reads a shard: a signal that came there is sent again a moment later.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    first: list[float] = []
    lost: list[Interrupted] = []

    def handle(number: int, _: FrameType | None) -> None:
        if not first:
            first.append(time.monotonic())
            raise Interrupted(number)
        if time.monotonic() - first[0] > _ONE_KEYPRESS_S:
            os._exit(128 + number)

    def thrown_away(unraisable: sys.UnraisableHookArgs) -> None:
        if not isinstance(unraisable.exc_value, Interrupted):
            tell(unraisable)
            return
        first.clear()
        lost[:] = [unraisable.exc_value]
        timer = threading.Timer(_ASK_AGAIN_S, send_again, (unraisable.exc_value.exit_code - 128,))
        timer.start()

    def send_again(number: int) -> None:
        # To the main thread: it may wait in a system call that has to end.
        if sys.unraisablehook is thrown_away:
            signal.pthread_kill(main, number)

    main = threading.get_ident()
    tell = sys.unraisablehook
    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    sys.unraisablehook = thrown_away
    try:
        yield
        if lost and not first:  # the block ended within the moment
            raise lost[0]
    finally:
        sys.unraisablehook = tell
        for number, handler in before.items():
            signal.signal(number, handler)
