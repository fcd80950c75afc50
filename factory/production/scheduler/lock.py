"""One run at a time in a folder, or at a URL, to which what it writes then goes.

In a folder that is a lock of the system, which ends with its process; the file names its owner for
people.  At a URL it is an object that is only written where there is none.  Its owner holds it as
long as it has written it in the last ten minutes, by its clock and ours; one that can be looked up
from here no longer than it lives.
"""

from __future__ import annotations

import errno
import json
import os
import secrets
import socket
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from ...common.errors import FactoryError
from ...common.files import explain_os_errors, forward_writes, is_dead, space
from ...common.small_files import parse_json, read_regular
from ...dataset.storage import SHARD_NAME, Store, make_room, take_copy, url_of

LOCK_NAME = ".lock"
# A process that only checks for other runs holds it for a moment.
_ASKING_S = 1.0
# What `flock` says where locks do not work.
_NO_LOCKS = {errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EBADF}
_BEAT_S = 20.0
_SILENT_S = 600.0


@contextmanager
def locked(folder: Path, part: str = "") -> Iterator[None]:
    """Within the block no other run writes there.  Raises FactoryError when one does.

    part: of a run that makes a slice of the dataset; other slices may run beside it.
    """
    path = folder / _name(part)
    # A soft lock would outlive a run that is killed.
    lock = FileLock(path, thread_local=False, fallback_to_soft=False)
    with explain_os_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        try:
            lock.acquire(timeout=_ASKING_S, poll_interval=0.05)
        except Timeout:
            raise _refused(folder, _owner(path)) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
            raise FactoryError(
                f"{folder}: its file system has no locks ({error.strerror}), which keep two runs "
                "apart; mount it with locks (NFS: start lockd, or mount with nfsvers=4), or give a "
                "folder elsewhere with dataset.dir= (docs/how-to/cluster.md)"
            ) from error
    try:
        with explain_os_errors(folder):
            path.write_text(json.dumps(_me()), encoding="ascii")
        for rival in _rivals(path.name, os.listdir(folder)):
            if _is_held(folder / rival):
                raise _refused(folder, _owner(folder / rival))
        yield
    finally:
        # Removed while it is held: a waiting process finds the file missing and creates another.
        with suppress(OSError):
            path.unlink()
        lock.release()


def owner_of(folder: Path) -> dict[str, Any] | None:
    """The process that works in this folder now (host, pid), or None."""
    paths = sorted(folder.glob(f"{LOCK_NAME}*"))
    return next((_owner(path) for path in paths if _is_held(path)), None)


@dataclass(frozen=True)
class Publication:
    """Passes on what is written into the copy of a dataset; goes to workers with each task.

    folder: the copy, absolute.  lock, token: the object that must hold this token.
    is_remote: workers see nothing of the folder, they run elsewhere.
    """

    folder: Path
    store: Store
    lock: str
    token: str
    is_remote: bool

    def forward(self, name: str, content: bytes | None) -> None:
        """Forward a file, see `files.forward_writes`; the copy keeps shards while there is room."""
        if not self.holds():
            raise FactoryError(
                f"{self.store.url}: was taken by another run while this one was suspended; nothing "
                "more is written"
            )
        if content is None:
            self.store.remove(name)
        else:
            self.store.put(name, content)
            if SHARD_NAME.fullmatch(name) and not self.is_remote:
                make_room(spare=self.folder / name)

    def text(self) -> bytes:
        """The content of the lock."""
        return json.dumps({"token": self.token, **_me(), "beat": time.time()}).encode()

    def holds(self) -> bool:
        """Whether the lock is ours."""
        return _read_lock(self.store, self.lock).get("token") == self.token


@contextmanager
def publishing(
    folder: Path, part: str = "", *, is_remote: bool = False
) -> Iterator[Publication | None]:
    """Within the block, what is written into the copy of a URL goes there; None for any other.

    The copy is brought up to date first, and holds no shard then: what counts is at the URL.
    Raises FactoryError when another run writes there, the URL holds something that is no dataset,
    or the storage cannot keep two runs apart.
    """
    url = url_of(folder)
    if url is None:
        yield None
        return
    store = Store(url)
    ended = threading.Event()
    token = secrets.token_hex(16)
    publication = Publication(Path(os.path.abspath(folder)), store, _name(part), token, is_remote)

    def beat() -> None:
        while not ended.wait(_BEAT_S):
            with suppress(FactoryError):
                if publication.holds():
                    store.put(publication.lock, publication.text())

    beating = threading.Thread(target=beat, daemon=True)
    _take_lock(publication)
    try:
        # Some servers do not know the condition and overwrite.
        if store.create(publication.lock, publication.text()):
            raise FactoryError(
                f"{url}: this storage overwrites objects although asked not to, so nothing would "
                "keep two runs apart; make the dataset in a folder and copy it"
            )
        sizes = store.sizes()
        for rival in _rivals(publication.lock, sizes):
            _refuse_if_held(store, rival)
        beating.start()
        _refuse_foreign_files(url, sizes)
        take_copy(folder, sizes, fresh=True)
        with forward_writes(publication.folder, publication.forward):
            yield publication
    finally:
        ended.set()
        if beating.ident is not None:
            # A beat under way would write the lock again after it was removed.
            beating.join()
        # Never another's; what cannot be removed is found dead later.
        with suppress(FactoryError):
            if publication.holds():
                store.remove(publication.lock)


def _take_lock(publication: Publication) -> None:
    """Create the lock; that of a dead run is removed first.  FactoryError when a run holds it."""
    store = publication.store
    if store.create(publication.lock, publication.text()):
        return
    dead = _refuse_if_held(store, publication.lock)
    if _read_lock(store, publication.lock) == dead:
        store.remove(publication.lock)
    if not store.create(publication.lock, publication.text()):
        raise FactoryError(f"{store.url}: another run takes its lock; try later")


def _refuse_foreign_files(url: str, names: Iterable[str]) -> None:
    """Raise FactoryError for a URL with files other than a dataset's."""
    # Slices of one dataset begin at the same time, and locks are all there is then.
    foreign = sorted(name for name in names if not name.startswith(LOCK_NAME))
    if foreign and not {"config.yaml", "manifest.json"} & set(foreign):
        raise FactoryError(
            f"dataset.dir: {url} holds other files ({', '.join(foreign[:3])}) and no dataset; "
            "give an empty or new place with dataset.dir="
        )


def _name(part: str) -> str:
    return f"{LOCK_NAME}.{part}" if part else LOCK_NAME


def _me() -> dict[str, Any]:
    return {"host": socket.gethostname(), "pid": os.getpid(), "space": space()}


def _rivals(lock: str, names: Iterable[str]) -> list[str]:
    """The locks that must not be held beside `lock`: the whole and a slice of it exclude others."""
    locks = (name for name in names if name.startswith(LOCK_NAME) and name != lock)
    return [name for name in locks if LOCK_NAME in (name, lock)]


def _owner(path: Path) -> dict[str, Any]:
    owner = {"pid": "?", "host": "?"}
    with suppress(OSError):
        owner |= _said(read_regular(path))
    return owner


def _read_lock(store: Store, name: str) -> dict[str, Any]:
    return _said(store.get(name) or b"")


def _said(content: bytes) -> dict[str, Any]:
    """What a lock says; empty when that is nothing."""
    with suppress(ValueError):
        if isinstance(said := parse_json(content), dict):
            return said
    return {}


def _is_held(path: Path) -> bool:
    try:
        with FileLock(path, timeout=0, thread_local=False):
            return False
    except Timeout:
        return True
    except OSError:  # no file, or not ours to open
        return False


def _refuse_if_held(store: Store, name: str) -> dict[str, Any]:
    """The content of a lock that no run holds any more; raises FactoryError for any other."""
    owner = _read_lock(store, name)
    beat = owner.get("beat")
    beats = isinstance(beat, float) and abs(time.time() - beat) < _SILENT_S
    if beats and not (owner.get("space") == space() and is_dead(owner["pid"])):
        raise _refused(store.url, owner)
    return owner


def _refused(directory: Path | str, owner: dict[str, Any]) -> FactoryError:
    return FactoryError(
        f"dataset.dir: {directory} is being written by process {owner.get('pid')} on "
        f"{owner.get('host')}; wait for it, or give another place with dataset.dir="
    )
