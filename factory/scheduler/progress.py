"""How far a run is: a bar on stderr, and status.json for other processes."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from ..dataset.folder import STATUS_NAME
from ..errors import FactoryError
from ..files import write_atomically
from ..progress import Lines, clock, stage, terminal_bars
from .plan import Job
from .settings import Crew
from .worker import AttemptState

if TYPE_CHECKING:
    from tqdm import tqdm

_EVERY_S = 1.0
# What a pair costs, in frames that are rendered.
_PAIR_SHARE = 0.1


class ProgressBar:
    """Counts of frames and pairs, shown on stderr and written to status.json.

    total: planned samples.  settled: of them, those that need no work any more.
    frames_total: frames to prepare.
    """

    def __init__(self, job: Job, crew: Crew, total: int, settled: int) -> None:
        self.frames_total = 0
        # Of the shards that are made, kept or given up; of them, those of frames that failed.
        self._settled, self._lost = settled, 0
        stem, _, suffix = STATUS_NAME.rpartition(".")
        part = f".{job.shard.part}" if job.shard.part else ""
        self._path = job.directory / f"{stem}{part}.{suffix}"
        self._total, self._first, self._pairs = total, settled, settled
        self._workers = {"render": crew.render, "noise": crew.noise}
        self._frames = {"rendered": 0, "from_cache": 0, "failed": 0}
        self._failed = 0
        self._begun, self._written = time.time(), 0.0
        self._lines, self._shown = Lines(), ""
        self._bar: tqdm[Any] | None = None
        if sys.stderr.isatty():
            # A terminal that does not tell its size would get an empty line.
            columns, rows = shutil.get_terminal_size()
            form = "{percentage:3.0f}%|{bar:20}| {desc}"
            self._bar = terminal_bars()(total=1.0, bar_format=form, ncols=columns, nrows=rows)
            self._draw()

    def prepared(self, hit: bool, failed: bool) -> None:
        """Count one frame that a render worker is done with."""
        self._frames["failed" if failed else "from_cache" if hit else "rendered"] += 1

    def settled(self, samples: int, lost: int) -> None:
        """Count the planned samples of one shard that needs no more work, and what it lost."""
        self._settled += samples
        self._lost += lost

    def show(self, shards: Sequence[AttemptState], failed: int) -> None:
        """Show how far it is; cheap enough to be called several times a second.

        shards: state of each that is being made.
        """
        self._pairs = self._settled + sum(state.samples for state in shards)
        self._failed = failed + sum(state.failed for state in shards)
        self._draw()
        if time.monotonic() - self._written > _EVERY_S:
            self._written = time.monotonic()
            self._write("running")

    def close(self, state: str) -> None:
        """The end: state is finished, stopped or broken."""
        self._draw(last=True)
        if self._bar is not None:
            self._bar.close()
        self._write(state)

    def _draw(self, *, last: bool = False) -> None:
        counts = self._counts()
        gone, left = time.time() - self._begun, None if last else self._left_s()
        text = f"{counts}; {clock(gone)} gone" + (f", {clock(left)} left" if left else "")
        if self._bar is not None:
            self._bar.n = max(self._bar.n, self._share())  # work that is lost does not show
            self._bar.set_description_str(text)
            return
        begun = sum(self._frames.values()) or self._pairs > self._first or self._failed
        if (begun and counts != self._shown) and (last or self._lines.due()):
            self._shown = counts
            stage(text)

    def _counts(self) -> str:
        """Such as `frames 3/40 (1 from cache), pairs 2/40, 1 failed`."""
        parts = []
        if self.frames_total:
            hits = self._frames["from_cache"]
            cached = f" ({hits} from cache)" if hits else ""
            parts.append(f"frames {sum(self._frames.values())}/{self.frames_total}{cached}")
        parts.append(f"pairs {self._pairs - self._lost}/{self._total}")
        if self._failed:
            parts.append(f"{self._failed} failed")
        return ", ".join(parts)

    def _share(self) -> float:
        """Of the work of this run, the part that is done: 0 to 1."""
        whole = self.frames_total + _PAIR_SHARE * (self._total - self._first)
        done = sum(self._frames.values()) + _PAIR_SHARE * (self._pairs - self._first)
        return min(done / whole, 1.0) if whole else 1.0

    def _left_s(self) -> float | None:
        """Seconds that are left at the rate so far; None before anything is done."""
        share = self._share()
        return (time.time() - self._begun) * (1 - share) / share if share else None

    def _write(self, state: str) -> None:
        seconds = time.time() - self._begun
        left = self._left_s()
        rate = (self._pairs - self._first) / seconds if seconds > 0 else 0.0
        document = {
            "state": state,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "begun": time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(self._begun)),
            "seconds": round(seconds, 1),
            "pairs": {"done": self._pairs - self._lost, "total": self._total},
            "pairs_per_second": round(rate, 3),
            "seconds_left": None if left is None else round(left),
            "frames": {"total": self.frames_total, **self._frames},
            "failed": self._failed,
            "workers": self._workers,
        }
        # Whoever writes what matters reports a full disk.
        with suppress(FactoryError, OSError):
            text = json.dumps(document, indent=1) + "\n"
            write_atomically(self._path, text.encode(), durable=False)
