"""What a long command says while it works: the stages of its start, and bars.

All of it goes to stderr.  On a terminal a bar is drawn anew in its place; in a file it is a line
now and then, which `tail -f` shows and which does not fill a disk.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

if TYPE_CHECKING:
    from tqdm import tqdm

_LINE_EVERY_S = 30.0


@cache
def terminal_bars() -> type[tqdm[Any]]:
    """tqdm, which is imported where a terminal needs it, with a lock of this process alone.

    The lock that tqdm makes by default is a semaphore of the system, which a worker that is killed
    leaves behind.
    """
    from tqdm import tqdm

    tqdm.set_lock(threading.RLock())
    tqdm.monitor_interval = 0  # nor a thread
    return tqdm


def stage(text: str) -> None:
    """Report what begins now."""
    terminal_bars().write(text, file=sys.stderr)
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


class _AsLines:
    """stderr of a file: what a bar draws anew is a line of its own."""

    def write(self, text: str) -> None:
        """What tqdm writes begins where the line began, and may be blank."""
        if line := text.strip("\r\n "):
            print(line, file=sys.stderr, flush=True)

    def flush(self) -> None:
        """Do nothing: no line is held back."""


def progress_bar(*, total: int, initial: int = 0, unit: str, desc: str) -> tqdm[Any]:
    """A bar over `total` steps that `update` counts; fit for where stderr goes.

    unit: what is counted, in the singular.  initial: this many of them were done before.
    """
    options: dict[str, Any] = {"total": total, "initial": initial, "unit": unit, "desc": desc}
    if sys.stderr.isatty():
        return terminal_bars()(**options, dynamic_ncols=True)
    form = "{desc}: {n_fmt} of {total_fmt} {unit}s in {elapsed}, {remaining} left{postfix}"
    options |= {"mininterval": _LINE_EVERY_S, "maxinterval": _LINE_EVERY_S, "delay": 1e-9}
    bar: tqdm[Any] = terminal_bars()(**options, file=_AsLines(), bar_format=form)
    for name in ("set_postfix", "set_postfix_str"):  # it would redraw at each
        setattr(bar, name, partial(getattr(bar, name), refresh=False))
    return bar


def clock(seconds: float) -> str:
    """`1:05` or `2:03:04`, as people read durations."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
