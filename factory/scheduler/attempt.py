"""One attempt at a shard or frame: how far it is, told by its worker, and its traceback.

The worker tells each step before it takes it, so that the run knows which frame was in hand when
the worker died.  When a worker crashes or hangs, the interpreter writes its traceback to a file.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from .workers.start import tell

START, DONE, FAILED = "start", "done", "failed"
_TRACEBACK_CHARACTERS = 4000


@dataclass
class AttemptState:
    """What the run knows of one attempt.

    samples: made so far.  failed: frames that failed so far.
    in_hand: index of the frame being worked on, or None between frames.
    begun: whether any frame was begun.  heard_at: when something was told last (time.monotonic).
    """

    samples: int = 0
    failed: int = 0
    in_hand: int | None = None
    begun: bool = False
    heard_at: float = field(default_factory=time.monotonic)

    def hear(self, message: tuple[str, int]) -> None:
        """Take in what the worker tells."""
        event, value = message
        self.heard_at = time.monotonic()
        if event == START:
            self.begun, self.in_hand = True, value
        else:
            self.in_hand = None
            self.samples += value if event == DONE else 0
            self.failed += event == FAILED

    def silent_s(self) -> float:
        """Seconds since something was told."""
        return time.monotonic() - self.heard_at


class Watch:
    """The clock of one attempt, in its worker."""

    def __init__(self, trace: int, frame_timeout_s: float) -> None:
        self._trace, self._frame_timeout_s = trace, frame_timeout_s
        # Only a process of its own may be ended from within; a test that calls may not.
        self._may_exit = multiprocessing.parent_process() is not None

    @contextmanager
    def watched(self) -> Iterator[None]:
        """End this process, traceback first, when the block outlasts the frame's time limit.

        The clock is a C thread of the interpreter: it also ends native code that never returns.
        """
        if not self._may_exit:
            yield
            return
        faulthandler.dump_traceback_later(self._frame_timeout_s, exit=True, file=self._trace)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()


@contextmanager
def watch(trace: Path, frame_timeout_s: float) -> Iterator[Watch]:
    """The watch of an attempt; `trace` gets the traceback of a crash, or of a frame that is late.

    Where that file cannot be written there is no traceback, and nothing else is lost.
    """
    descriptor = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError):
        trace.parent.mkdir(parents=True, exist_ok=True)
        written = os.open(trace, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        os.close(descriptor)
        descriptor = written
    crash_reports = multiprocessing.parent_process() is not None
    try:
        if crash_reports:
            faulthandler.enable(file=descriptor)
        yield Watch(descriptor, frame_timeout_s)
    finally:
        if crash_reports:
            faulthandler.disable()
        os.close(descriptor)


def say(event: str, value: int) -> None:
    """Tell the run: START of frame `value`, DONE with `value` samples, or FAILED."""
    tell(event, value)


def traceback_in(trace: Path) -> str:
    """The traceback that the interpreter left when it crashed or was too late; mostly empty."""
    try:
        text = trace.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    for mark in ("Fatal Python error", "Timeout ("):
        if mark in text:
            # The thread that was at work comes first; the others only wait.
            paragraphs = text[text.index(mark) :].split("\n\n")[:2]
            return "\n" + "\n".join(paragraphs)[:_TRACEBACK_CHARACTERS].rstrip()
    return ""
