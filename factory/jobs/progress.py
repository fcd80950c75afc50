"""How far a run is: a bar on stderr, and status.json for other processes."""

from __future__ import annotations

import json
import os
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from tqdm import tqdm

from simnfnd.factory.dataset.format.manifest import part_name
from simnfnd.factory.dataset.write.folder import STATUS_NAME
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import write_atomically
from simnfnd.factory.jobs.job import Job
from simnfnd.factory.jobs.journal import read_journal
from simnfnd.factory.jobs.settings import Crew

_EVERY_S = 1.0


class ProgressBar:
    """Counts, shown on stderr and written to status.json.

    total: planned samples.  settled: of them, those that need no work any more.
    settled_samples: planned samples of the shards that are settled (made, kept or given up).
    """

    def __init__(self, job: Job, crew: Crew, total: int, settled: int) -> None:
        self.settled_samples = settled
        self.frames_total = 0
        self._path = job.directory / part_name(STATUS_NAME, job.shard.part)
        self._total, self._first = total, settled
        self._workers = {"render": crew.render, "noise": crew.noise}
        self._frames = {"rendered": 0, "from_cache": 0, "failed": 0}
        self._failed = 0
        self._begun, self._written = time.time(), 0.0
        tty = sys.stderr.isatty()
        self._bar: tqdm[Any] = tqdm(
            total=total,
            initial=settled,
            unit="pair",
            desc="pairs",
            mininterval=0.1 if tty else 30.0,
            dynamic_ncols=tty,
        )

    def prepared(self, hit: bool, failed: bool) -> None:
        """Count one frame that a render worker is done with."""
        self._frames["failed" if failed else "from_cache" if hit else "rendered"] += 1

    def show(self, journals: Sequence[Path], failed: int) -> None:
        """Show how far it is; cheap enough to be called several times a second."""
        states = [read_journal(journal) for journal in journals]
        samples = self.settled_samples + sum(state.samples for state in states)
        self._failed = failed + sum(state.failed for state in states)
        parts = []
        if self.frames_total:
            done = sum(self._frames.values())
            parts.append(f"frames {done}/{self.frames_total}")
            if self._frames["from_cache"]:
                parts.append(f"{self._frames['from_cache']} from cache")
        if self._failed:
            parts.append(f"{self._failed} failed")
        if parts:
            self._bar.set_postfix_str(", ".join(parts), refresh=False)
        self._bar.update(samples - self._bar.n)
        if time.monotonic() - self._written > _EVERY_S:
            self._written = time.monotonic()
            self._write("running")

    def close(self, state: str) -> None:
        """The end: state is finished, stopped or broken."""
        self._bar.close()
        self._write(state)

    def _write(self, state: str) -> None:
        seconds = time.time() - self._begun
        made = self._bar.n - self._first
        rate = made / seconds if seconds > 0 else 0.0
        document = {
            "state": state,
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "begun": time.strftime("%Y-%m-%dT%H:%M:%S%z", time.localtime(self._begun)),
            "seconds": round(seconds, 1),
            "pairs": {"done": int(self._bar.n), "total": self._total},
            "pairs_per_second": round(rate, 3),
            "seconds_left": round((self._total - self._bar.n) / rate) if rate else None,
            "frames": {"total": self.frames_total, **self._frames},
            "failed": self._failed,
            "workers": self._workers,
        }
        # Whoever writes what matters reports a full disk.
        with suppress(FactoryError, OSError):
            text = json.dumps(document, indent=1) + "\n"
            write_atomically(self._path, text.encode(), durable=False)
