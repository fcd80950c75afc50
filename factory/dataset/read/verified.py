"""Shards that this process has found sound: opened again, they are not checked again.

A check takes twenty times as long as opening a file, and a reader that visits ten thousand shards
in any order opens one for every sample.
"""

from __future__ import annotations

import time
from pathlib import Path

# (inode, bytes, time of change in ns) of a file.
State = tuple[int, int, int]

_MOST = 1 << 15
# A file that changed so lately can change again without its time telling.
_SETTLED_NS = 2_000_000_000

_found: dict[Path, State] = {}


def state_of(path: Path) -> State:
    """What tells a file from any that comes in its place.  Raises OSError."""
    now = path.stat()
    return now.st_ino, now.st_size, now.st_mtime_ns


def is_sound(path: Path, state: State) -> bool:
    """Whether the file in this state was checked."""
    return _found.get(path) == state


def note_sound(path: Path, state: State, *, ours: bool = False) -> None:
    """The file was checked in this state.  ours: nobody else writes it."""
    if not ours and time.time_ns() - state[2] < _SETTLED_NS:
        return
    if len(_found) >= _MOST:
        _found.clear()
    _found[path] = state
