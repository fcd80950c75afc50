"""One thread of one process at a time fetches a shard; others that want it wait for that."""

from __future__ import annotations

import fcntl
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

# Files that are locked, in each copy: shards share them by their names, so that none is left
# behind for each shard.
_LOCKS = 64
_LONGEST_S = 120.0
_EVERY_S = 0.005


@contextmanager
def alone(path: Path, *, wait: bool = True) -> Iterator[bool]:
    """Within the block nobody else fetches this shard of a copy; false where another does now.

    wait: for the other, until the shard is there, or two minutes.  Then, and where the file system
    has no locks, the answer is true all the same: the shard is fetched twice at worst.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    number = zlib.crc32(path.name.encode()) % _LOCKS
    # Opened anew by every thread, so that threads keep each other out as processes do.
    with (path.parent.parent / f".fetching-{number:02d}").open("ab") as file:
        mine = _locked(file.fileno())
        end = time.monotonic() + _LONGEST_S
        while wait and not mine and not path.exists() and time.monotonic() < end:
            time.sleep(_EVERY_S)
            mine = _locked(file.fileno())
        try:
            yield mine or wait
        finally:
            # Closing is not enough: a process forked meanwhile has it open, too.
            if mine:
                with suppress(OSError):
                    fcntl.flock(file, fcntl.LOCK_UN)


def _locked(lock: int) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # none to be had here
        return True
    return True
