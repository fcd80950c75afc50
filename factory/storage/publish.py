"""What a run writes into the copy of a dataset goes to its URL, whole, while the run owns it."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import FactoryError
from ..files import outlet
from .copies import shard_names, take_copy, url_of
from .lock import LOCK_NAME, StoreLock, read_lock
from .room import make_room
from .store import Store

_OURS = ("config.yaml", "manifest.json")


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
        name = self._name(path)
        self._check()
        Store(self.url).put(name, content)
        if shard_names({name: 0}) and not self.apart:
            make_room(spare=path)

    def remove(self, path: Path) -> None:
        """As `Outlet` says."""
        self._check()
        Store(self.url).remove(self._name(path))

    def names(self) -> list[str]:
        """The shards at the URL."""
        return shard_names(Store(self.url).sizes())

    def _name(self, path: Path) -> str:
        return Path(os.path.abspath(path)).relative_to(self.folder).as_posix()

    def _check(self) -> None:
        owner = read_lock(Store(self.url), self.lock)
        if owner.get("token") != self.token:
            taken = f"by process {owner['pid']} on {owner['host']}" if "pid" in owner else "away"
            raise FactoryError(
                f"{self.url}: was taken {taken} while this run stood still; nothing more is "
                "written here"
            )


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
    with ExitStack() as held:
        lock = held.enter_context(StoreLock(store, part))
        sizes = store.sizes()
        if not any(name in sizes for name in _OURS):
            # Slices begin side by side.
            foreign = [name for name in sizes if not name.startswith(LOCK_NAME)]
            if foreign:
                listed = ", ".join(sorted(foreign)[:3]) + (", ..." if len(foreign) > 3 else "")
                raise FactoryError(
                    f"dataset.dir: {url} holds other files ({listed}) and no dataset; "
                    "give an empty or new place with dataset.dir="
                )
        take_copy(folder, sizes, fresh=True)
        one = Publication(Path(os.path.abspath(folder)), url, lock.name, lock.token, apart)
        held.enter_context(outlet(one))
        yield one


@contextmanager
def apart_copy(publication: Publication) -> Iterator[Publication]:
    """The publication of a worker that runs elsewhere: its folder lasts as long as the block."""
    with tempfile.TemporaryDirectory(prefix="simnfnd-shard-") as name:
        one = replace(publication, folder=Path(name).resolve())
        with outlet(one):
            yield one
