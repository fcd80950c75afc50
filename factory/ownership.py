"""Who owns a folder: processes told apart across containers and machines, and writes that ask.

A worker that outlived its run writes no more into a folder that is another run's by now.
"""

from __future__ import annotations

import hashlib
import json
import os
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from .errors import FactoryError
from .small_files import parse_json, read_regular

_MOST_BYTES = 1 << 12


@cache
def space() -> str:
    """8 hexadecimal digits for where a process number means something.

    That is one boot of one machine, and there one name space of process numbers: containers that
    share a host name have process 1 each.
    """
    try:
        boot = Path("/proc/sys/kernel/random/boot_id").read_text(encoding="ascii")
        told = boot + os.readlink("/proc/self/ns/pid")
    except (OSError, UnicodeDecodeError):
        told = socket.gethostname()
    return hashlib.blake2b(told.encode(), digest_size=4).hexdigest()


def myself() -> dict[str, Any]:
    """This process, as `is_alive` takes it."""
    pid = os.getpid()
    return {
        "host": socket.gethostname(),
        "space": space(),
        "pid": pid,
        "started": _started(pid),
    }


def is_alive(told: Mapping[str, Any]) -> bool | None:
    """Whether the process that `myself` told of runs; None when that cannot be seen from here."""
    if told.get("space") != space() or not Path("/proc/self/stat").exists():
        return None
    pid, started = told.get("pid"), told.get("started")
    if type(pid) is not int or not 0 < pid < 1 << 31:
        return False
    # The number may have been given to another process since.
    return started is not None and _started(pid) == started


def _started(pid: int) -> float | None:
    """When a process started, in ticks since the machine did; None when there is none.

    No clock that somebody sets: the seconds that psutil gives move with it.  Without /proc nobody
    is seen, and a lock at a URL holds as long as it is written.
    """
    try:
        # Its name, in brackets, may hold anything.
        fields = Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()
        dead = fields[0] in (b"Z", b"X")  # its parent has not collected it yet
        return None if dead else float(int(fields[19]))
    except (OSError, IndexError, ValueError):
        return None


@dataclass(frozen=True)
class Fence:
    """lock: absolute path of a lock file, without `..`.  token: what it holds while it is ours."""

    lock: Path
    token: str

    def check(self) -> None:
        """Raise FactoryError when the lock is another's, or gone."""
        owner = read_owner(self.lock)
        if owner.get("token") != self.token:
            raise taken(self.lock.parent, owner)


def taken(place: Path | str, owner: Mapping[str, Any]) -> FactoryError:
    """The error of a run that has lost its folder or URL to another."""
    by = f"by process {owner['pid']} on {owner.get('host')}" if "pid" in owner else "away"
    return FactoryError(
        f"{place}: was taken {by} while this run stood still; nothing more is written here"
    )


# Of this process.
_fences: list[Fence] = []


@contextmanager
def fenced(fence: Fence | None) -> Iterator[None]:
    """Within the block, `check_fences` checks this one, too."""
    if fence is None:
        yield
        return
    _fences.append(fence)
    try:
        yield
    finally:
        _fences.remove(fence)


def check_fences(path: Path) -> None:
    """Raise FactoryError when `path` lies in a folder that this process had and lost."""
    place = Path(os.path.abspath(path))
    for fence in _fences:
        if place.is_relative_to(fence.lock.parent):
            fence.check()


def read_owner(lock: Path) -> dict[str, Any]:
    """What a lock file says; empty when it is absent or says nothing."""
    try:
        owner = parse_json(read_regular(lock, _MOST_BYTES))
    except (OSError, ValueError):
        return {}
    return owner if isinstance(owner, dict) else {}


def owner_text(owner: dict[str, Any]) -> bytes:
    """The content of a lock file."""
    return json.dumps(owner).encode()
