"""What a long command says while it works: the stages of its start, and bars.

All of it goes to stderr.  On a terminal a bar is drawn anew in its place; in a file it is a line
now and then, which `tail -f` shows and which does not fill a disk.
"""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple, Self

_LINE_EVERY_S = 30.0
_DRAW_EVERY_S = 0.1
_CLEAR = "\r\x1b[K"  # of a terminal: begin the line again


def stage(text: str) -> None:
    """Report what begins now."""
    if sys.stderr.isatty():
        text = f"{_CLEAR}{text}"
    print(text, file=sys.stderr, flush=True)


def draw_line(text: str) -> None:
    """Draw the last line of a terminal anew."""
    columns = shutil.get_terminal_size().columns
    sys.stderr.write(_CLEAR + text[: columns - 1])
    sys.stderr.flush()


class RunProgress(NamedTuple):
    """How far a run is.

    share: part of the whole work that is done, 0 to 1.  seconds: since the run began.
    """

    pairs_done: int
    pairs_total: int
    frames_rendered: int
    frames_total: int
    frames_failed: int
    share: float
    seconds: float


def print_fact(text: str) -> None:
    """Print a line on stdout."""
    print(text, flush=True)


def print_warning(text: str) -> None:
    """Print a line on stderr."""
    print(f"warning: {text}", file=sys.stderr, flush=True)


@dataclass(frozen=True)
class RunReporter:
    """Where a run reports what it finds and does; by default on stdout and stderr.

    progress: called several times per second in place of the bar.
    """

    fact: Callable[[str], None] = print_fact
    warning: Callable[[str], None] = print_warning
    stage: Callable[[str], None] = stage
    progress: Callable[[RunProgress], None] | None = None


@contextmanager
def stage_if_slow(
    text: str, after_s: float = 1.0, *, tell: Callable[[str], None] = stage
) -> Iterator[None]:
    """Say what goes on in the block once it has lasted `after_s` seconds; mostly it does not."""
    timer = threading.Timer(after_s, tell, [text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class Lines:
    """When a line is due in a file: the first at once, then ever more rarely up to a limit."""

    def __init__(self) -> None:
        self._begun = time.monotonic()
        self._next = 0.0

    def due(self) -> bool:
        """Whether to write one now; if so, the next is due some time later."""
        elapsed_s = time.monotonic() - self._begun
        if elapsed_s < self._next:
            return False
        self._next = elapsed_s + min(_LINE_EVERY_S, max(2.0, elapsed_s))
        return True


class Bar:
    """Counts steps on stderr: one line that is drawn anew on a terminal, some lines in a file.

    total, n: steps in all, and those that are done.
    uncounted: files that will add to the total when they are opened.
    """

    def __init__(self, *, total: int, initial: int = 0, unit: str, desc: str) -> None:
        """unit: what is counted, in the singular.  initial: steps that were done before."""
        self.total = total
        self.n = initial
        self.uncounted = 0
        self._initial = initial
        self._unit = unit
        self._desc = desc
        self._postfix = ""
        self._begun = time.monotonic()
        self._next_s = 0.0
        self._is_drawn = sys.stderr.isatty()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def update(self) -> None:
        """Count a step."""
        self.n += 1
        if time.monotonic() - self._begun >= self._next_s:
            self.refresh()

    def set_postfix(self, text: str) -> None:
        """What the line ends with from now on."""
        self._postfix = f", {text}"

    def refresh(self) -> None:
        """Show how far it is."""
        elapsed_s = time.monotonic() - self._begun
        self._next_s = elapsed_s + (_DRAW_EVERY_S if self._is_drawn else _LINE_EVERY_S)
        text = (
            f"{self._desc}: {self.n} of {self.total} {self._unit}s in {clock(elapsed_s)}"
            f"{self._left(elapsed_s)}{self._postfix}"
        )
        if self._is_drawn:
            draw_line(text)
        else:
            print(text, file=sys.stderr, flush=True)

    def close(self) -> None:
        """Show the last state, and end the line."""
        self.uncounted = 0
        if self.total:
            self.refresh()
        if self._is_drawn:
            print(file=sys.stderr)

    def _left(self, elapsed_s: float) -> str:
        steps = self.n - self._initial
        more = f" and {self.uncounted} more file(s)" if self.uncounted else ""
        if not steps or (self.n >= self.total and not more):
            return more
        return f", {clock(elapsed_s / steps * (self.total - self.n))} left{more}"


def clock(seconds: float) -> str:
    """`1:05` or `2:03:04`, as people read durations."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
