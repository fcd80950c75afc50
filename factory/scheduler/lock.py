"""One run at a time in a folder: a lock file that names its owner and ends with it.

An owner is known by a token, which no other has.  Where its process number means something
(`ownership.space`) it is looked up by that and its start.  Elsewhere, on another machine or in
another container, it cannot be; so a thread of the owner touches the lock now and then, whatever
the owner does, and it counts as dead when that has not been done for ten minutes.
"""

from __future__ import annotations

import os
import secrets
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from ..errors import FactoryError
from ..files import explain_os_errors
from ..ownership import Fence, fenced, is_alive, myself, owner_text, read_owner

LOCK_NAME = ".lock"
_BEAT_S = 20.0
_SILENT_S = 600.0


class Lock:
    """`with Lock(folder):` no other run writes there.  Raises FactoryError when one does.

    part: of a run that makes a slice of the dataset; other slices may run beside it.
    fence: asked before every write of this process to the folder; workers ask it, too.
    """

    def __init__(self, folder: Path, part: str = "") -> None:
        self.path = folder / (f"{LOCK_NAME}.{part}" if part else LOCK_NAME)
        self.fence = Fence(Path(os.path.abspath(self.path)), secrets.token_hex(16))
        self._ended = threading.Event()
        self._heart = threading.Thread(target=self._beat, daemon=True)
        self._lost = False
        self._held = ExitStack()

    def __enter__(self) -> Lock:
        owner = {"token": self.fence.token, **myself()}
        with explain_os_errors(self.path.parent):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            # Written aside and linked: no reader ever sees half a lock.
            aside = self._aside("claim")
            aside.write_bytes(owner_text(owner))
            try:
                while not self._taken(aside):
                    self._remove_if_dead()
            finally:
                aside.unlink(missing_ok=True)
        self._held.enter_context(fenced(self.fence))
        self._heart.start()
        try:
            self._refuse_overlap()
        except FactoryError:
            self.__exit__()
            raise
        self._sweep()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._held.close()
        # Never another's: it may have been taken over.
        if read_owner(self.path).get("token") == self.fence.token:
            self.path.unlink(missing_ok=True)

    def check(self) -> None:
        """Raise FactoryError when the lock was found to be another's; costs nothing."""
        if self._lost:
            self.fence.check()

    def _beat(self) -> None:
        while not self._ended.wait(_BEAT_S):
            self._lost = read_owner(self.path).get("token") != self.fence.token
            if not self._lost:
                with suppress(OSError):
                    os.utime(self.path)

    def _refuse_overlap(self) -> None:
        """The whole and a slice of it must not run at once."""
        whole = self.path.name == LOCK_NAME
        for path in sorted(self.path.parent.glob(f"{LOCK_NAME}*")):
            if path != self.path and (whole or path.name == LOCK_NAME):
                owner = read_owner(path)
                if _holds(owner, path):
                    raise self._refused(owner)

    def _refused(self, owner: dict[str, Any]) -> FactoryError:
        return FactoryError(
            f"dataset.dir: {self.path.parent} is being written by process {owner.get('pid')} "
            f"on {owner.get('host')}; wait for it, or give another folder with dataset.dir="
        )

    def _aside(self, what: str) -> Path:
        return self.path.with_name(f".{what}-{secrets.token_hex(8)}.tmp")

    def _sweep(self) -> None:
        """Remove what those left who were killed while they took a lock."""
        for path in self.path.parent.glob(".*-*.tmp"):
            if path.name.startswith((".claim-", ".dead-")):
                with suppress(OSError):
                    if time.time() - path.stat().st_mtime > _SILENT_S:
                        path.unlink()

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
        owner = read_owner(self.path)
        if _holds(owner, self.path):
            raise self._refused(owner)
        # Of two that find the owner dead, the slower one must not remove the lock of the faster.
        moved = self._aside("dead")
        with suppress(FileNotFoundError):
            os.rename(self.path, moved)
            if read_owner(moved) != owner:
                with suppress(FileExistsError):
                    os.link(moved, self.path)
            if moved.is_dir():
                moved.rmdir()
            else:
                moved.unlink()


def owner_of(folder: Path) -> dict[str, Any] | None:
    """The process that works in this folder now (host, pid), or None."""
    for path in sorted(folder.glob(f"{LOCK_NAME}*")):
        owner = read_owner(path)
        if _holds(owner, path):
            return owner
    return None


def _holds(owner: dict[str, Any], path: Path) -> bool:
    """Whether the owner of a lock at `path` is at work."""
    # Written whole: what names nobody was never a lock of ours.
    if type(owner.get("pid")) is not int or not isinstance(owner.get("host"), str):
        return False
    seen = is_alive(owner)
    if seen is not None:
        return seen
    try:
        # Also not when it was touched in a future that no clocks that nearly agree can have.
        return abs(time.time() - path.stat().st_mtime) < _SILENT_S
    except OSError:
        return False
