"""One run at a time in a folder: a lock of the system, which ends with its process.

The lock file names its owner for people.
"""

from __future__ import annotations

import json
import os
import socket
from contextlib import suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from ..errors import FactoryError
from ..files import explain_os_errors
from ..small_files import parse_json, read_regular

LOCK_NAME = ".lock"
# Who only asks whether somebody is at work holds it for a moment.
_ASKING_S = 1.0
_MOST_BYTES = 1 << 12


class Lock:
    """`with Lock(folder):` no other run writes there.  Raises FactoryError when one does.

    part: of a run that makes a slice of the dataset; other slices may run beside it.
    """

    def __init__(self, folder: Path, part: str = "") -> None:
        self.path = folder / (f"{LOCK_NAME}.{part}" if part else LOCK_NAME)
        self._lock = FileLock(self.path, thread_local=False)

    def __enter__(self) -> Lock:
        with explain_os_errors(self.path.parent):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            try:
                self._lock.acquire(timeout=_ASKING_S, poll_interval=0.05)
            except Timeout:
                raise _refused(self.path) from None
            owner = {"host": socket.gethostname(), "pid": os.getpid()}
            self.path.write_text(json.dumps(owner), encoding="ascii")
        try:
            # The whole and a slice of it must not run at once.
            whole = self.path.name == LOCK_NAME
            for path in _locks(self.path.parent):
                if path != self.path and (whole or path.name == LOCK_NAME) and _is_held(path):
                    raise _refused(path)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        # While it is held: who waits for it finds that the file is gone, and makes another.
        with suppress(OSError):
            self.path.unlink()
        self._lock.release()


def owner_of(folder: Path) -> dict[str, Any] | None:
    """The process that works in this folder now (host, pid), or None."""
    return next((_owner(path) for path in _locks(folder) if _is_held(path)), None)


def _locks(folder: Path) -> list[Path]:
    return sorted(folder.glob(f"{LOCK_NAME}*"))


def _owner(path: Path) -> dict[str, Any]:
    try:
        owner = parse_json(read_regular(path, _MOST_BYTES))
    except (OSError, ValueError):
        owner = None
    return {"pid": "?", "host": "?", **(owner if isinstance(owner, dict) else {})}


def _is_held(path: Path) -> bool:
    lock = FileLock(path, thread_local=False)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return True
    except OSError:  # no file, or not ours to open
        return False
    lock.release()
    return False


def _refused(path: Path) -> FactoryError:
    owner = _owner(path)
    return FactoryError(
        f"dataset.dir: {path.parent} is being written by process {owner['pid']} "
        f"on {owner['host']}; wait for it, or give another folder with dataset.dir="
    )
