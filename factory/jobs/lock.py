"""One run at a time in a folder: a lock file that names its owner and ends with it.

On the same machine the owner is looked up by process number and start time.  Another machine's
process cannot be, so an owner touches its lock now and then, and counts as dead when it has not
done so for ten minutes.
"""

from __future__ import annotations

import json
import os
import socket
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import explain_os_errors

LOCK_NAME = ".lock"
_BEAT_S = 20.0
_SILENT_S = 600.0


class Lock:
    """`with Lock(folder):` no other run writes there.  Raises FactoryError when one does.

    part: of a run that makes a slice of the dataset; other slices may run beside it.
    """

    def __init__(self, folder: Path, part: str = "") -> None:
        self.path = folder / (f"{LOCK_NAME}.{part}" if part else LOCK_NAME)
        self._beaten = 0.0
        self._held = False

    def __enter__(self) -> Lock:
        content = json.dumps(_myself()).encode()
        with explain_os_errors(self.path.parent):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # Written aside and linked: no reader ever sees half a lock.
            aside = self.path.with_name(f".claim-{socket.gethostname()}-{os.getpid()}.tmp")
            aside.write_bytes(content)
            try:
                while not self._taken(aside):
                    self._remove_if_dead()
            finally:
                aside.unlink(missing_ok=True)
        self._held, self._beaten = True, time.monotonic()
        try:
            self._refuse_overlap()
        except FactoryError:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._held = False
        self.path.unlink(missing_ok=True)

    def beat(self) -> None:
        """Touch the lock so that it stays valid; cheap enough to be called often."""
        if self._held and time.monotonic() - self._beaten > _BEAT_S:
            self._beaten = time.monotonic()
            with suppress(OSError):
                os.utime(self.path)

    def _refuse_overlap(self) -> None:
        """The whole and a slice of it must not run at once."""
        whole = self.path.name == LOCK_NAME
        for path in sorted(self.path.parent.glob(f"{LOCK_NAME}*")):
            if path != self.path and (whole or path.name == LOCK_NAME):
                owner, silent_s = _read(path)
                if _alive(owner, silent_s):
                    raise self._refused(owner)

    def _refused(self, owner: dict[str, Any]) -> FactoryError:
        return FactoryError(
            f"dataset.dir: {self.path.parent} is being written by process {owner.get('pid')} "
            f"on {owner.get('host')}; wait for it, or give another folder with dataset.dir="
        )

    def _taken(self, aside: Path) -> bool:
        try:
            os.link(aside, self.path)
        except FileExistsError:
            return False
        except OSError:  # a file system without hard links
            try:
                with self.path.open("xb") as file:
                    file.write(aside.read_bytes())
            except FileExistsError:
                return False
        return True

    def _remove_if_dead(self) -> None:
        try:
            content = self.path.read_bytes()
        except FileNotFoundError:
            return
        owner, silent_s = _read(self.path)
        if _alive(owner, silent_s):
            raise self._refused(owner)
        # Of two that find the owner dead, the slower one must not remove the lock of the faster.
        moved = self.path.with_name(f".dead-{socket.gethostname()}-{os.getpid()}.tmp")
        with suppress(FileNotFoundError):
            os.rename(self.path, moved)
            if moved.read_bytes() != content:
                with suppress(FileExistsError):
                    os.link(moved, self.path)
            moved.unlink()


def owner_of(folder: Path) -> dict[str, Any] | None:
    """The process that works in this folder now (host, pid, started), or None."""
    for path in sorted(folder.glob(f"{LOCK_NAME}*")):
        owner, silent_s = _read(path)
        if _alive(owner, silent_s):
            return owner
    return None


def _read(path: Path) -> tuple[dict[str, Any], float]:
    """The owner of a lock and the seconds since it was touched; without a pid when unreadable."""
    try:
        silent_s = time.time() - path.stat().st_mtime
        owner = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {"host": socket.gethostname()}, 0.0
    if not isinstance(owner, dict) or "host" not in owner:
        return {"host": socket.gethostname()}, silent_s
    return owner, silent_s


def _myself() -> dict[str, Any]:
    return {
        "host": socket.gethostname(),
        "pid": os.getpid(),
        "started": psutil.Process().create_time(),
    }


def _alive(owner: dict[str, Any], silent_s: float) -> bool:
    if owner.get("host") != socket.gethostname():
        return silent_s < _SILENT_S
    try:
        process = psutil.Process(int(owner["pid"]))
        # The number may have been given to another process since.
        same = abs(process.create_time() - float(owner["started"])) < 1.0
        return same and process.status() != psutil.STATUS_ZOMBIE
    except psutil.AccessDenied:
        return True
    except (psutil.NoSuchProcess, KeyError, TypeError, ValueError):
        return False
