"""One run at a time in a folder: a lock of the system, which ends with its process.

The lock file names its owner for people, and holds a token that workers ask for: one that outlived
its run writes nothing into what is another's by now.
"""

from __future__ import annotations

import os
import secrets
from contextlib import suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from ..errors import FactoryError
from ..files import explain_os_errors
from ..ownership import Fence, myself, owner_text, read_owner

LOCK_NAME = ".lock"
# Who only asks whether somebody is at work holds it for a moment.
_ASKING_S = 1.0


class Lock:
    """`with Lock(folder):` no other run writes there.  Raises FactoryError when one does.

    part: of a run that makes a slice of the dataset; other slices may run beside it.
    fence: workers ask it before they put a shard in its place.
    """

    def __init__(self, folder: Path, part: str = "") -> None:
        self.path = folder / (f"{LOCK_NAME}.{part}" if part else LOCK_NAME)
        self.fence = Fence(Path(os.path.abspath(self.path)), secrets.token_hex(16))
        self._lock = FileLock(self.path, thread_local=False)

    def __enter__(self) -> Lock:
        with explain_os_errors(self.path.parent):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            _clear(self.path)
            try:
                self._lock.acquire(timeout=_ASKING_S, poll_interval=0.05)
            except Timeout:
                raise _refused(self.path) from None
            self.path.write_bytes(owner_text({"token": self.fence.token, **myself()}))
        try:
            self._refuse_overlap()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        # While it is held: who waits for it finds that the file is gone, and makes another.
        with suppress(OSError):
            self.path.unlink()
        self._lock.release()

    def _refuse_overlap(self) -> None:
        """The whole and a slice of it must not run at once."""
        whole = self.path.name == LOCK_NAME
        for path in sorted(self.path.parent.glob(f"{LOCK_NAME}*")):
            if path != self.path and (whole or path.name == LOCK_NAME) and _is_held(path):
                raise _refused(path)


def owner_of(folder: Path) -> dict[str, Any] | None:
    """The process that works in this folder now (host, pid), or None."""
    for path in sorted(folder.glob(f"{LOCK_NAME}*")):
        if _is_held(path):
            return {"pid": "?", "host": "?", **read_owner(path)}
    return None


def _is_held(path: Path) -> bool:
    if not path.is_file():
        return False
    lock = FileLock(path, thread_local=False)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        return True
    except OSError:  # not ours to open
        return False
    lock.release()
    return False


def _clear(path: Path) -> None:
    """Remove what lies in place of a lock and is no file."""
    if path.is_dir():
        path.rmdir()
    elif path.exists() and not path.is_file():
        path.unlink()


def _refused(path: Path) -> FactoryError:
    owner = read_owner(path)
    return FactoryError(
        f"dataset.dir: {path.parent} is being written by process {owner.get('pid')} "
        f"on {owner.get('host')}; wait for it, or give another folder with dataset.dir="
    )
