"""Workers that stand still: stopped by a debugger or the system, too stuck to watch themselves.

A worker ends itself when a frame takes too long (`journal.watched`).  One that was stopped cannot,
so the run looks at what the journals of its tasks gain.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from .journal import read_journal
from .settings import SchedulerSettings

# For the worker to end itself first, which leaves its traceback; on other machines also for what
# their file system shows late.
_GRACE_S = {"local": 10.0, "dask": 60.0}
# Without a frame in hand a process starts, or a shard is written to a slow disk.
_BETWEEN_FRAMES_S = 60.0
# What was asked to end and did not is asked again.
_AGAIN_S = 30.0


class Standstill:
    """Finds the tasks whose journals have gained nothing for too long."""

    def __init__(self, scheduler: SchedulerSettings) -> None:
        self._limit_s = scheduler.frame_timeout_s
        self._grace_s = _GRACE_S.get(scheduler.backend, 0.0)
        self._seen: dict[Path, tuple[int, float]] = {}
        self._named: dict[Path, float] = {}

    def among(
        self, running: Mapping[Future[Any], tuple[Any, Path]], now: float
    ) -> Iterator[Future[Any]]:
        """The futures of those tasks; each is named again while it lasts, every half minute.

        running: future -> (work, journal).  now: of a clock that never goes back, in seconds.
        """
        journals = {journal for _, journal in running.values()}
        self._seen = {path: seen for path, seen in self._seen.items() if path in journals}
        self._named = {path: when for path, when in self._named.items() if path in journals}
        for future, (_, journal) in running.items():
            size = _size(journal)
            before, since = self._seen.get(journal, (-2, now))
            if size != before:
                self._seen[journal] = (size, now)
                self._named.pop(journal, None)
            elif now - self._named.get(journal, -_AGAIN_S) < _AGAIN_S:
                continue
            elif now - since > self._limit_s + self._grace_s and self._is_late(
                journal, now - since
            ):
                self._named[journal] = now
                yield future

    def _is_late(self, journal: Path, silent_s: float) -> bool:
        return (
            read_journal(journal).in_hand is not None
            or silent_s > self._limit_s + self._grace_s + _BETWEEN_FRAMES_S
        )


def _size(journal: Path) -> int:
    try:
        return journal.stat().st_size
    except OSError:
        return -1
