"""Which process owns something: processes told apart across containers and machines."""

from __future__ import annotations

import hashlib
import os
import socket
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from .errors import FactoryError


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


def taken(place: str, owner: Mapping[str, Any]) -> FactoryError:
    """The error of a run that has lost its URL to another."""
    by = f"by process {owner['pid']} on {owner.get('host')}" if "pid" in owner else "away"
    return FactoryError(
        f"{place}: was taken {by} while this run stood still; nothing more is written here"
    )
