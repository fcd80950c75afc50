"""How far a worker is with a shard, in a file that outlives the worker.

One short line an event, written at once with one system call: a worker may be killed at any moment
without damage, and the parent still learns how far it came and which frame it had in
hand.  No locks and no queues, so it works for any number of processes and over shared disks.
When a worker crashes or hangs, the interpreter adds its traceback to the same file.
"""

from __future__ import annotations

import faulthandler
import multiprocessing
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..files import explain_os_errors

_START, _DONE, _FAILED = "start", "done", "failed"
# Any other line is the interpreter's traceback, or was cut off.
_LINE = re.compile(r"(start|done|failed)((?: [0-9]{1,9})+)", re.ASCII)
_TIMEOUT_MARK = "Timeout ("

Tell = Callable[[Path, bytes], None]


@dataclass(frozen=True)
class AttemptState:
    """State of one attempt at a shard.

    samples: made so far.  failed: frames that failed so far.
    in_hand: index of the frame being worked on, or None between frames.
    begun: whether any frame was begun.
    timed_out: whether the worker ended itself because a frame took too long.
    """

    samples: int = 0
    failed: int = 0
    in_hand: int | None = None
    begun: bool = False
    timed_out: bool = False


class AttemptJournal:
    """The writing side, in the worker."""

    def __init__(
        self, path: Path, descriptor: int, frame_timeout_s: float, tell: Tell | None = None
    ) -> None:
        self._path, self._descriptor, self._tell = path, descriptor, tell
        self._frame_timeout_s = frame_timeout_s
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
        faulthandler.dump_traceback_later(self._frame_timeout_s, exit=True, file=self._descriptor)
        try:
            yield
        finally:
            faulthandler.cancel_dump_traceback_later()

    def start(self, index: int) -> None:
        """Frame `index` of the shard is begun."""
        self._write(_START, index)
        if self._tell:
            self._tell(self._path, self._path.read_bytes())

    def done(self, index: int, samples: int) -> None:
        """Frame `index` gave `samples` samples."""
        self._write(_DONE, index, samples)

    def failed(self, index: int) -> None:
        """Frame `index` gave nothing."""
        self._write(_FAILED, index)

    def _write(self, event: str, *values: int) -> None:
        line = " ".join([event, *map(str, values)]) + "\n"
        with explain_os_errors(self._path):
            os.write(self._descriptor, line.encode())


@contextmanager
def open_journal(
    path: Path, frame_timeout_s: float, tell: Tell | None = None
) -> Iterator[AttemptJournal]:
    """Open a new journal at `path` for the time of one attempt.

    tell: called with path and content before each frame, where the run does not see the file.
    """
    with explain_os_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    crash_reports = multiprocessing.parent_process() is not None
    try:
        if crash_reports:
            faulthandler.enable(file=descriptor)
        yield AttemptJournal(path, descriptor, frame_timeout_s, tell)
    finally:
        if crash_reports:
            faulthandler.disable()
        os.close(descriptor)


def read_journal(path: Path) -> AttemptState:
    """The state that the journal at `path` records; the initial one when there is none yet."""
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return AttemptState()
    samples, failed, in_hand, begun = 0, 0, None, False
    for line in text.split("\n")[:-1]:
        match = _LINE.fullmatch(line)
        event, values = (
            (match[1], [int(value) for value in match[2].split()]) if match else ("", [])
        )
        if event == _START:
            begun, in_hand = True, values[0]
        elif event == _DONE:
            in_hand, samples = None, samples + values[-1]
        elif event == _FAILED:
            in_hand, failed = None, failed + 1
    return AttemptState(samples, failed, in_hand, begun, _TIMEOUT_MARK in text)
