"""What a long command says while it works: the stages of its start, and bars.

All of it goes to stderr.  On a terminal a bar is drawn anew in its place; in a file it is a line
now and then, which `tail -f` shows and which does not fill a disk.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from tqdm import tqdm

_LINE_EVERY_S = 30.0


@cache
def terminal_bars() -> type[tqdm[Any]]:
    """tqdm, which is imported where a terminal needs it, with a lock of this process alone.

    The lock that tqdm makes by itself is a semaphore of the system, which a worker that is killed
    leaves behind.
    """
    from tqdm import tqdm

    tqdm.set_lock(threading.RLock())
    return tqdm


def stage(text: str) -> None:
    """Say what begins now."""
    terminal_bars().write(text, file=sys.stderr)
    sys.stderr.flush()


@contextmanager
def stage_if_slow(text: str, after_s: float = 1.0) -> Iterator[None]:
    """Say what goes on in the block once it has lasted `after_s` seconds; mostly it does not."""
    timer = threading.Timer(after_s, stage, [text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


class Lines:
    """When a line is due in a file: the first at once, then ever more rarely up to a limit."""

    def __init__(self, every_s: float = _LINE_EVERY_S) -> None:
        self._every_s, self._begun = every_s, time.monotonic()
        self._next = 0.0

    def due(self) -> bool:
        """Whether to write one now; if so, the next is due some time later."""
        gone = time.monotonic() - self._begun
        if gone < self._next:
            return False
        self._next = gone + min(self._every_s, max(2.0, gone))
        return True


class LineBar:
    """A bar for files: one line now and then, and one at the end.  Used as a bar of tqdm."""

    def __init__(self, *, total: int, initial: int, unit: str, desc: str) -> None:
        self.n, self.total = initial, total
        self._initial, self._unit, self._desc = initial, unit, desc
        self._begun, self._lines = time.monotonic(), Lines()
        self._postfix, self._told = "", -1

    def update(self, n: int = 1) -> None:
        """So many more are done."""
        self.n += n
        if n and self._lines.due():
            self._tell()

    def set_postfix(self, **values: object) -> None:
        """What else to tell, by name."""
        self.set_postfix_str(", ".join(f"{name} {value}" for name, value in values.items()))

    def set_postfix_str(self, text: str) -> None:
        """The same as a text."""
        self._postfix = f"; {text}" if text else ""

    def close(self) -> None:
        """The end."""
        if self.n != self._told and self.n > self._initial:
            self._tell()

    def _tell(self) -> None:
        self._told = self.n
        gone = time.monotonic() - self._begun
        done, left = self.n - self._initial, max(0, self.total - self.n)
        more = f", {clock(gone / done * left)} left" if left and done else ""
        text = f"{self._desc}: {self.n} of {self.total} {self._unit}s in {clock(gone)}{more}"
        print(f"{text}{self._postfix}", file=sys.stderr, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def progress_bar(*, total: int, initial: int = 0, unit: str, desc: str) -> tqdm[Any] | LineBar:
    """A bar over `total` steps that `update` counts; fit for where stderr goes.

    unit: what is counted, in the singular.  initial: so many of them were done before.
    """
    how: dict[str, Any] = {"total": total, "initial": initial, "unit": unit, "desc": desc}
    return terminal_bars()(**how, dynamic_ncols=True) if sys.stderr.isatty() else LineBar(**how)


def clock(seconds: float) -> str:
    """`1:05` or `2:03:04`, as people read durations."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
