"""How far a run is: a bar on stderr, and status.json for other processes."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Sequence
from contextlib import suppress

from ...common.errors import FactoryError
from ...common.files import write_atomically
from ...common.progress import Lines, RunProgress, clock, draw_line
from ...dataset.folder import STATUS_NAME
from .plan import DatasetJob

_EVERY_S = 1.0
# What a pair costs, in frames that are rendered.
_PAIR_SHARE = 0.1
_BAR_WIDTH = 20


class ProgressBar:
    """Counts of frames and pairs, shown on stderr and written to status.json.

    frames: counts of those to prepare (total) and of what became of them.
    settled: planned samples of the shards that need no more work; lost, lost_frames: of those, the
        samples that no frame gave, and the frames that failed.
    """

    def __init__(self, job: DatasetJob, total: int, settled: int) -> None:
        """total: planned samples.  settled: of them, those that need no work from the first."""
        self.frames = {"total": 0, "rendered": 0, "from_cache": 0, "failed": 0}
        self.settled = settled
        self.lost = 0
        self.lost_frames = 0
        part = f".{job.shard.part}." if job.shard.part else "."
        self._path = job.directory / STATUS_NAME.replace(".", part)
        self._total = total
        self._first = settled
        self._pairs = settled
        self._failed = 0
        self._begun = time.monotonic()
        self._written = 0.0
        self._lines = Lines()
        self._shown = ""
        self._reporter = job.reporter
        self._drawn_share = 0.0
        self._is_drawn = self._reporter.progress is None and sys.stderr.isatty()
        if self._is_drawn:
            self._draw()

    def show(self, shards: Sequence[tuple[object, int, int]]) -> None:
        """Show how far it is; cheap enough to be called several times per second.

        shards: what each that is being made has told: (frame, samples, failed frames).
        """
        self._pairs = self.settled + sum(samples for _, samples, _ in shards)
        self._failed = self.lost_frames + sum(failed for *_, failed in shards)
        self._draw()
        if time.monotonic() - self._written > _EVERY_S:
            self._written = time.monotonic()
            self._write("running")

    def close(self, state: str) -> None:
        """The end: state is finished, stopped or broken."""
        self._draw(last=True)
        if self._is_drawn:
            print(file=sys.stderr)
        self._write(state)

    def _prepared(self) -> int:
        return sum(self.frames.values()) - self.frames["total"]

    def _draw(self, *, last: bool = False) -> None:
        """Show how far the run is: to a callback, on a bar, or as a line now and then."""
        elapsed_s, share = self._rate()
        if self._reporter.progress is not None:
            self._reporter.progress(self._snapshot(elapsed_s, share))
            return
        # Such as `frames 3/40 (1 from cache), pairs 2/40, 1 failed`.
        counts = f"pairs {self._pairs - self.lost}/{self._total}"
        if total := self.frames["total"]:
            hits = self.frames["from_cache"]
            cached = f" ({hits} from cache)" if hits else ""
            counts = f"frames {self._prepared()}/{total}{cached}, {counts}"
        if self._failed:
            counts += f", {self._failed} failed"
        left = (
            f", {clock(elapsed_s / share - elapsed_s)} left" if 0 < share < 1 and not last else ""
        )
        text = f"{counts}; {clock(elapsed_s)} elapsed{left}"
        if self._is_drawn:
            self._drawn_share = max(self._drawn_share, share)  # work that is lost does not show
            full = "#" * round(self._drawn_share * _BAR_WIDTH)
            draw_line(f"{self._drawn_share:4.0%} |{full:{_BAR_WIDTH}}| {text}")
            return
        begun = self._prepared() or self._pairs > self._first or self._failed
        if begun and counts != self._shown and (last or self._lines.due()):
            self._shown = counts
            self._reporter.stage(text)

    def _snapshot(self, elapsed_s: float, share: float) -> RunProgress:
        return RunProgress(
            pairs_done=self._pairs - self.lost,
            pairs_total=self._total,
            frames_rendered=self._prepared() - self.frames["failed"],
            frames_total=self.frames["total"],
            frames_failed=self._failed,
            share=share,
            seconds=elapsed_s,
        )

    def _rate(self) -> tuple[float, float]:
        """Seconds since the begin, and the part of this run's work that is done: 0 to 1."""
        whole = self.frames["total"] + _PAIR_SHARE * (self._total - self._first)
        done = self._prepared() + _PAIR_SHARE * (self._pairs - self._first)
        return time.monotonic() - self._begun, min(done / whole, 1.0) if whole else 1.0

    def _write(self, state: str) -> None:
        elapsed_s, share = self._rate()
        document = {
            "state": state,
            "pairs": {"done": self._pairs - self.lost, "total": self._total},
            "pairs_per_second": round((self._pairs - self._first) / max(elapsed_s, 1e-9), 3),
            "seconds_left": round(elapsed_s / share - elapsed_s) if share else None,
            "frames": self.frames,
        }
        # Whoever writes what matters reports a full disk.
        with suppress(FactoryError, OSError):
            text = json.dumps(document, indent=1) + "\n"
            write_atomically(self._path, text.encode(), durable=False)
