"""One run at a time in a folder, or at a URL.

In a folder that is a lock of the system, which ends with its process; the file names its owner for
people.  At a URL it is an object that is only written where there is none.  Its owner holds it as
long as it has written it in the last ten minutes, by its clock and ours; one that can be looked up
from here no longer than it lives.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from ..errors import FactoryError
from ..files import explain_os_errors, is_dead, space
from ..small_files import parse_json, read_regular
from ..storage.copies import Store

LOCK_NAME = ".lock"
# Who only asks whether somebody is at work holds it for a moment.
_ASKING_S = 1.0
_MOST_BYTES = 1 << 12
_BEAT_S = 20.0
_SILENT_S = 600.0


@contextmanager
def locked(folder: Path, part: str = "") -> Iterator[None]:
    """Within the block no other run writes there.  Raises FactoryError when one does.

    part: of a run that makes a slice of the dataset; other slices may run beside it.
    """
    path = folder / _name(part)
    lock = FileLock(path, thread_local=False)
    with explain_os_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire(timeout=_ASKING_S, poll_interval=0.05)
        except Timeout:
            raise _refused(folder, _owner(path)) from None
    try:
        with explain_os_errors(folder):
            path.write_text(json.dumps(_me()), encoding="ascii")
        for other in _rivals(path.name, os.listdir(folder)):
            if _is_held(folder / other):
                raise _refused(folder, _owner(folder / other))
        yield
    finally:
        # While it is held: who waits for it finds that the file is gone, and makes another.
        with suppress(OSError):
            path.unlink()
        lock.release()


def owner_of(folder: Path) -> dict[str, Any] | None:
    """The process that works in this folder now (host, pid), or None."""
    paths = sorted(folder.glob(f"{LOCK_NAME}*"))
    return next((_owner(path) for path in paths if _is_held(path)), None)


@contextmanager
def url_locked(store: Store, part: str = "") -> Iterator[tuple[str, str]]:
    """Within the block no other run writes at the URL.  Raises FactoryError when one does.

    part: as for `locked`.  Yields name and token of the lock: who finds another token has lost it.
    """
    name, token, ended = _name(part), secrets.token_hex(16), threading.Event()

    def text() -> bytes:
        return json.dumps({"token": token, **_me(), "beat": time.time()}).encode()

    def is_ours() -> bool:
        return read_lock(store, name).get("token") == token

    def beat() -> None:
        while not ended.wait(_BEAT_S):
            with suppress(FactoryError):
                if is_ours():
                    store.put(name, text())

    if not store.create(name, text()):
        dead = _refuse_if_held(store, name)
        if read_lock(store, name) == dead:
            store.remove(name)
        if not store.create(name, text()):
            raise FactoryError(f"{store.url}: another run takes its lock; try later")
    try:
        # Some servers do not know the condition and overwrite.
        if store.create(name, text()):
            raise FactoryError(
                f"{store.url}: this storage overwrites where it is told not to, so nothing would "
                "keep two runs apart; make the dataset in a folder and copy it"
            )
        for other in _rivals(name, store.sizes()):
            _refuse_if_held(store, other)
        threading.Thread(target=beat, daemon=True).start()
        yield name, token
    finally:
        ended.set()
        # Never another's; what cannot be removed is found dead later.
        with suppress(FactoryError):
            if is_ours():
                store.remove(name)


def read_lock(store: Store, name: str) -> dict[str, Any]:
    """What the lock of a URL says; empty when it is absent or says nothing."""
    return _said(store.get(name) or b"")


def _name(part: str) -> str:
    return f"{LOCK_NAME}.{part}" if part else LOCK_NAME


def _me() -> dict[str, Any]:
    return {"host": socket.gethostname(), "pid": os.getpid(), "space": space()}


def _rivals(own: str, names: Iterable[str]) -> list[str]:
    """The locks that must not be held beside `own`: the whole and a slice of it exclude others."""
    locks = (name for name in names if name.startswith(LOCK_NAME) and name != own)
    return [name for name in locks if LOCK_NAME in (name, own)]


def _owner(path: Path) -> dict[str, Any]:
    with suppress(OSError):
        return {"pid": "?", "host": "?", **_said(read_regular(path, _MOST_BYTES))}
    return {"pid": "?", "host": "?"}


def _said(content: bytes) -> dict[str, Any]:
    with suppress(ValueError):
        said = parse_json(content)
        return said if isinstance(said, dict) else {}
    return {}


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


def _refuse_if_held(store: Store, name: str) -> dict[str, Any]:
    """What a lock says that nobody holds any more; raises FactoryError for any other."""
    owner = read_lock(store, name)
    beat = owner.get("beat")
    beats = isinstance(beat, float) and abs(time.time() - beat) < _SILENT_S
    if beats and not (owner.get("space") == space() and is_dead(owner["pid"])):
        raise _refused(store.url, owner)
    return owner


def _refused(where: Path | str, owner: dict[str, Any]) -> FactoryError:
    return FactoryError(
        f"dataset.dir: {where} is being written by process {owner.get('pid')} on "
        f"{owner.get('host')}; wait for it, or give another place with dataset.dir="
    )
