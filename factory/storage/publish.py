"""What a run writes into the copy of a dataset goes to its URL, whole, while the run owns it.

The lock is an object that is only written where there is none.  Its owner holds it as long as it
has written it in the last ten minutes, by its clock and ours; one that can be looked up from here
no longer than it lives.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import FactoryError
from ..files import is_dead, outlet, space
from ..small_files import parse_json
from .copies import make_room, shard_names, take_copy, url_of
from .store import Store

LOCK_NAME = ".lock"
_BEAT_S = 20.0
_SILENT_S = 600.0


class StoreLock:
    """`with StoreLock(store):` no other run writes there.  Raises FactoryError when one does.

    part: of a run that makes a slice of the dataset; other slices may run beside it.
    """

    def __init__(self, store: Store, part: str = "") -> None:
        self.store = store
        self.name = f"{LOCK_NAME}.{part}" if part else LOCK_NAME
        self.token = secrets.token_hex(16)
        self._ended = threading.Event()

    def __enter__(self) -> StoreLock:
        self._take()
        try:
            # The whole and a slice of it must not run at once.
            for name in self.store.sizes():
                whole = LOCK_NAME in (name, self.name)
                if name.startswith(LOCK_NAME) and name != self.name and whole:
                    self._refuse_if_held(name)
        except FactoryError:
            self.__exit__()
            raise
        threading.Thread(target=self._beat, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        # Never another's; what cannot be removed is found dead later.
        with suppress(FactoryError):
            if self._is_ours():
                self.store.remove(self.name)

    def _text(self) -> bytes:
        return json.dumps(
            {
                "token": self.token,
                "host": socket.gethostname(),
                "space": space(),
                "pid": os.getpid(),
                "beat": time.time(),
            }
        ).encode()

    def _is_ours(self) -> bool:
        return read_lock(self.store, self.name).get("token") == self.token

    def _take(self) -> None:
        if not self.store.create(self.name, self._text()):
            owner = self._refuse_if_held(self.name)
            if read_lock(self.store, self.name) == owner:
                self.store.remove(self.name)
            if not self.store.create(self.name, self._text()):
                raise FactoryError(f"{self.store.url}: another run takes its lock; try later")
        # Some servers do not know the condition and overwrite.
        if self.store.create(self.name, self._text()):
            raise FactoryError(
                f"{self.store.url}: this storage overwrites where it is told not to, so nothing "
                "would keep two runs apart; make the dataset in a folder and copy it"
            )

    def _beat(self) -> None:
        while not self._ended.wait(_BEAT_S):
            with suppress(FactoryError):
                if self._is_ours():
                    self.store.put(self.name, self._text())

    def _refuse_if_held(self, name: str) -> dict[str, Any]:
        """What a lock says that nobody holds any more; raises FactoryError for any other."""
        owner = read_lock(self.store, name)
        beat, pid = owner.get("beat"), owner.get("pid")
        held = isinstance(beat, float) and abs(time.time() - beat) < _SILENT_S
        if owner.get("space") == space() and type(pid) is int and 0 < pid < 1 << 31:
            held = held and not is_dead(pid)
        if held:
            raise FactoryError(
                f"dataset.dir: {self.store.url} is being written by process {owner.get('pid')} on "
                f"{owner.get('host')}; wait for it, or give another place with dataset.dir="
            )
        return owner


def read_lock(store: Store, name: str) -> dict[str, Any]:
    """What a lock says; empty when it is absent or says nothing."""
    try:
        owner = parse_json(store.get(name) or b"")
    except ValueError:
        return {}
    return owner if isinstance(owner, dict) else {}


@dataclass(frozen=True)
class Publication:
    """An `Outlet` to a URL; goes to workers with each task.

    folder: the copy, absolute.  lock, token: the object that must hold this token.
    apart: workers see nothing of the folder, they run elsewhere.
    """

    folder: Path
    url: str
    lock: str
    token: str
    apart: bool = False

    def put(self, path: Path, content: bytes) -> None:
        """As `Outlet` says; shards stay in the copy as long as there is room."""
        store, name = self._owned(), self._name(path)
        store.put(name, content)
        if shard_names({name: 0}) and not self.apart:
            make_room(spare=path)

    def remove(self, path: Path) -> None:
        """As `Outlet` says."""
        self._owned().remove(self._name(path))

    def _name(self, path: Path) -> str:
        return Path(os.path.abspath(path)).relative_to(self.folder).as_posix()

    def _owned(self) -> Store:
        store = Store(self.url)
        owner = read_lock(store, self.lock)
        if owner.get("token") != self.token:
            by = f"by process {owner['pid']} on {owner.get('host')}" if "pid" in owner else "away"
            raise FactoryError(
                f"{self.url}: was taken {by} while this run stood still; nothing more is written"
            )
        return store


@contextmanager
def publishing(
    folder: Path, part: str = "", *, apart: bool = False
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
    with StoreLock(store, part) as lock:
        sizes = store.sizes()
        # Slices begin side by side.
        foreign = sorted(name for name in sizes if not name.startswith(LOCK_NAME))
        if foreign and not {"config.yaml", "manifest.json"} & set(foreign):
            raise FactoryError(
                f"dataset.dir: {url} holds other files ({', '.join(foreign[:3])}) and no dataset; "
                "give an empty or new place with dataset.dir="
            )
        take_copy(folder, sizes, fresh=True)
        one = Publication(Path(os.path.abspath(folder)), url, lock.name, lock.token, apart)
        with outlet(one):
            yield one


@contextmanager
def apart_copy(publication: Publication) -> Iterator[Publication]:
    """The publication of a worker that runs elsewhere: its folder lasts as long as the block."""
    with tempfile.TemporaryDirectory(prefix="simnfnd-shard-") as name:
        one = replace(publication, folder=Path(name).resolve())
        with outlet(one):
            yield one
