"""logs/: a text file for each shard that had trouble or lacks a frame: what happened, and when."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

from ..dataset.write.folder import LOGS_NAME
from .pending import PendingFrame, PendingShard
from .worker import ShardResult

_AT_ONCE = getattr(os, "O_NONBLOCK", 0)


class ShardLog:
    """Writes the logs of one dataset.  A log that cannot be written is skipped."""

    def __init__(self, directory: Path) -> None:
        self._folder = directory / LOGS_NAME

    def death(self, work: PendingShard | PendingFrame, reason: str, told: str) -> None:
        """A worker died over a shard, or a frame that shards wait for.  told: its traceback."""
        shards = [work] if isinstance(work, PendingShard) else work.waiting
        what = "" if isinstance(work, PendingShard) else f"preparing {work.ref.name}, "
        for shard in shards:
            self._write(shard, f"{what}try {work.number}: {reason}{told}")

    def finished(self, shard: PendingShard, result: ShardResult) -> None:
        """The shard is settled."""
        for failure in result.failures:
            self._write(shard, f"left out ({failure.kind}): {failure.reason}")
        if result.failures or shard.deaths or shard.rounds:
            made = f"{result.info.samples} samples" if result.info else "kept as it was"
            self._write(shard, f"settled: {made if result.info or result.kept else 'no sample'}")

    def _write(self, shard: PendingShard, text: str) -> None:
        path = self._folder / f"{shard.task.path.replace('/', '-').removesuffix('.h5')}.log"
        with suppress(OSError):
            self._folder.mkdir(exist_ok=True)
            # Whatever lies there: to open a pipe would wait for ever.
            descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | _AT_ONCE, 0o644)
            with open(descriptor, "a", encoding="utf-8") as file:
                file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')} {text}\n")
