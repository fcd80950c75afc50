"""One run at a time at a URL: an object that is only written where there is none.

As `factory.scheduler.lock` keeps it in folders: an owner that can be looked up from here is;
any other holds as long as it has written its lock in the last ten minutes, by the storage's clock
and ours.
"""

from __future__ import annotations

import json
import secrets
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from typing import Any

from ..errors import FactoryError
from ..ownership import is_alive, myself
from ..small_files import parse_json
from .store import Store

LOCK_NAME = ".lock"
_BEAT_S = 20.0
_SILENT_S = 600.0
_TRIES = 5


class StoreLock:
    """`with StoreLock(store):` no other run writes there.  Raises FactoryError when one does.

    part: of a run that makes a slice of the dataset; other slices may run beside it.
    """

    def __init__(self, store: Store, part: str = "") -> None:
        self.store = store
        self.name = f"{LOCK_NAME}.{part}" if part else LOCK_NAME
        self.token = secrets.token_hex(16)
        self._ended = threading.Event()
        self._heart = threading.Thread(target=self._beat, daemon=True)

    def __enter__(self) -> StoreLock:
        self._take()
        try:
            self._refuse_overlap()
        except FactoryError:
            self.__exit__()
            raise
        self._heart.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        # Never another's; what cannot be removed is found dead later.
        with suppress(FactoryError):
            if read_lock(self.store, self.name).get("token") == self.token:
                self.store.remove(self.name)

    def _text(self) -> bytes:
        return json.dumps({"token": self.token, **myself(), "beat": time.time()}).encode()

    def _take(self) -> None:
        for _ in range(_TRIES):
            if self.store.create(self.name, self._text()):
                # Some servers do not know the condition and overwrite.
                if self.store.create(self.name, self._text()):
                    raise FactoryError(
                        f"{self.store.url}: this storage overwrites where it is told not to, so "
                        "nothing would keep two runs apart; make the dataset in a folder and copy "
                        "it"
                    )
                return
            owner = read_lock(self.store, self.name)
            if self._holds(owner, self.name):
                raise self._refused(owner)
            if read_lock(self.store, self.name) == owner:
                self.store.remove(self.name)
        raise FactoryError(f"{self.store.url}: others take its lock again and again; try later")

    def _beat(self) -> None:
        while not self._ended.wait(_BEAT_S):
            with suppress(FactoryError):
                if read_lock(self.store, self.name).get("token") == self.token:
                    self.store.put(self.name, self._text())

    def _refuse_overlap(self) -> None:
        """The whole and a slice of it must not run at once."""
        whole = self.name == LOCK_NAME
        for name in self.store.sizes():
            other = name == LOCK_NAME or name.startswith(f"{LOCK_NAME}.")
            if other and name != self.name and (whole or name == LOCK_NAME):
                owner = read_lock(self.store, name)
                if self._holds(owner, name):
                    raise self._refused(owner)

    def _holds(self, owner: Mapping[str, Any], name: str) -> bool:
        if type(owner.get("pid")) is not int or not isinstance(owner.get("host"), str):
            return False
        seen = is_alive(owner)
        if seen is not None:
            return seen
        changed = self.store.changed(name)
        if changed is None:
            return False
        when = changed if changed.tzinfo else changed.replace(tzinfo=UTC)
        return abs((datetime.now(UTC) - when).total_seconds()) < _SILENT_S

    def _refused(self, owner: Mapping[str, Any]) -> FactoryError:
        return FactoryError(
            f"dataset.dir: {self.store.url} is being written by process {owner.get('pid')} on "
            f"{owner.get('host')}; wait for it, or give another place with dataset.dir="
        )


def read_lock(store: Store, name: str) -> dict[str, Any]:
    """What a lock says; empty when it is absent or says nothing."""
    content = store.get(name)
    try:
        owner = parse_json(content or b"")
    except ValueError:
        return {}
    return owner if isinstance(owner, dict) else {}
