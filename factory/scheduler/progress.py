"""How far a run is: a bar on stderr, and status.json for other processes."""

from __future__ import annotations

import json
import os
import shutil
import socket
import sys
import time
from collections import deque
from collections.abc import Iterable, Sequence
from contextlib import suppress
from typing import Any

from tqdm import tqdm

from ..dataset.write.folder import STATUS_NAME
from ..errors import FactoryError
from ..files import write_atomically
from ..progress import Lines, clock, stage
from .attempt import AttemptState
from .job import Job
from .settings import Crew

_EVERY_S = 1.0
_WINDOW = 32
# What a pair costs, in frames, while none was made yet.
_PAIR_SHARE = 0.1


class Estimate:
    """Seconds that are left, from what frames and pairs took so far, from the first one on.

    render: workers that prepare frames; all: of both kinds.
    """

    def __init__(self, crew: Crew) -> None:
        self._render, self._all = max(1, crew.render), max(1, crew.total)
        self._frames_s: deque[float] = deque(maxlen=_WINDOW)
        self._starts = self._render
        self._pairs_s, self._pairs = 0.0, 0
        self._running_s, self._running = 0.0, 0

    def frame(self, seconds: float) -> None:
        """A frame was prepared."""
        if not self._starts:
            # The first frame of a worker has its libraries to load; the next ones tell better.
            self._frames_s.clear()
        self._starts -= 1
        self._frames_s.append(seconds)

    def pairs(self, seconds: float, count: int) -> None:
        """So many pairs were made of prepared frames, by one worker."""
        if count:
            self._pairs_s, self._pairs = self._pairs_s + seconds, self._pairs + count

    def running(self, shards: Iterable[tuple[float, int]]) -> None:
        """Seconds and pairs so far of each shard that is being made."""
        begun = [(seconds, count) for seconds, count in shards if count]
        self._running_s = sum(seconds for seconds, _ in begun)
        self._running = sum(count for _, count in begun)

    def costs_s(self) -> tuple[float, float]:
        """Worker seconds of a frame and of a pair; 0 for what is not known at all."""
        frame_s = sum(self._frames_s) / len(self._frames_s) if self._frames_s else 0.0
        pairs, pairs_s = self._pairs + self._running, self._pairs_s + self._running_s
        pair_s = pairs_s / pairs if pairs else _PAIR_SHARE * frame_s
        return frame_s, pair_s

    def left_s(self, frames: int, pairs: int) -> float | None:
        """Until so many frames and pairs are made; None before anything was."""
        frame_s, pair_s = self.costs_s()
        if not frame_s and not pair_s:
            return None
        rendering_s = frames * frame_s
        return max(rendering_s / self._render, (rendering_s + pairs * pair_s) / self._all)


class ProgressBar:
    """Counts of frames and pairs, shown on stderr and written to status.json.

    total: planned samples.  settled: of them, those that need no work any more.
    settled_samples: planned samples of the shards that are settled (made, kept or given up).
    lost_samples: of them, those of frames that failed.
    """

    def __init__(self, job: Job, crew: Crew, total: int, settled: int) -> None:
        self.settled_samples = settled
        self.lost_samples = 0
        self.frames_total = 0
        self.estimate = Estimate(crew)
        self._path = job.directory / _status_name(job.shard.part)
        self._total, self._first, self._pairs = total, settled, settled
        self._workers = {"render": crew.render, "noise": crew.noise}
        self._frames = {"rendered": 0, "from_cache": 0, "failed": 0}
        self._failed = 0
        self._begun, self._written = time.time(), 0.0
        self._lines, self._shown = Lines(), ""
        tty = sys.stderr.isatty()
        self._bar: tqdm[Any] | None = None
        if tty:
            # A terminal that does not tell its size would get an empty line.
            columns, rows = shutil.get_terminal_size()
            form = "{percentage:3.0f}%|{bar:20}| {desc}"
            self._bar = tqdm(total=1.0, bar_format=form, ncols=columns, nrows=rows)
            self._draw()

    def prepared(self, hit: bool, failed: bool, seconds: float = 0.0) -> None:
        """Count one frame that a render worker is done with after so many seconds."""
        self._frames["failed" if failed else "from_cache" if hit else "rendered"] += 1
        if not failed:
            self.estimate.frame(seconds)

    def show(self, shards: Sequence[tuple[AttemptState, float]], failed: int) -> None:
        """Show how far it is; cheap enough to be called several times a second.

        shards: state of each that is being made, and when it was begun.
        """
        states = [state for state, _ in shards]
        now = time.monotonic()
        self.estimate.running((now - begun, state.samples) for state, begun in shards)
        self._pairs = self.settled_samples + sum(state.samples for state in states)
        self._failed = failed + sum(state.failed for state in states)
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
            frame_s, pair_s = self.estimate.costs_s()
            frame_s, pair_s = (frame_s, pair_s) if pair_s else (1.0, _PAIR_SHARE)
            frames, pairs = sum(self._frames.values()), self._pairs - self._first
            work = self.frames_total * frame_s + (self._total - self._first) * pair_s
            # Costs are learnt on the way, and a bar that goes back would say that work is lost.
            done = (frames * frame_s + pairs * pair_s) / work if work else 1.0
            self._bar.n = max(self._bar.n, min(done, 1.0))
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
        parts.append(f"pairs {self._pairs - self.lost_samples}/{self._total}")
        if self._failed:
            parts.append(f"{self._failed} failed")
        return ", ".join(parts)

    def _left_s(self) -> float | None:
        frames = self.frames_total - sum(self._frames.values())
        return self.estimate.left_s(max(0, frames), self._total - self._pairs)

    def _write(self, state: str) -> None:
        seconds = time.time() - self._begun
        made = self._pairs - self._first
        left = self._left_s()
        rate = made / seconds if seconds > 0 else 0.0
        document = {
            "state": state,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "begun": time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(self._begun)),
            "seconds": round(seconds, 1),
            "pairs": {"done": self._pairs - self.lost_samples, "total": self._total},
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


def _status_name(part: str) -> str:
    stem, _, suffix = STATUS_NAME.rpartition(".")
    return f"{stem}.{part}.{suffix}" if part else STATUS_NAME
