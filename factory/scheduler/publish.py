"""What a run writes into the copy of a dataset goes to its URL, whole, while the run owns it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ..errors import FactoryError
from ..files import outlet
from ..storage.copies import Store, is_shard, make_room, take_copy, url_of
from .lock import LOCK_NAME, read_lock, url_locked


@dataclass(frozen=True)
class Publication:
    """Passes on what is written into a copy; goes to workers with each task.

    folder: the copy, absolute.  lock, token: the object that must hold this token.
    apart: workers see nothing of the folder, they run elsewhere.
    """

    folder: Path
    store: Store
    lock: str
    token: str
    apart: bool = False

    def pass_on(self, name: str, content: bytes | None) -> None:
        """As `files.outlet` says; shards stay in the copy as long as there is room."""
        owner = read_lock(self.store, self.lock)
        if owner.get("token") != self.token:
            by = f"by process {owner['pid']} on {owner.get('host')}" if "pid" in owner else "away"
            raise FactoryError(
                f"{self.store.url}: was taken {by} while this run stood still; nothing more is "
                "written"
            )
        if content is None:
            self.store.remove(name)
        else:
            self.store.put(name, content)
            if is_shard(name) and not self.apart:
                make_room(spare=self.folder / name)


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
    with url_locked(store, part) as (lock, token):
        sizes = store.sizes()
        # Slices begin side by side.
        foreign = sorted(name for name in sizes if not name.startswith(LOCK_NAME))
        if foreign and not {"config.yaml", "manifest.json"} & set(foreign):
            raise FactoryError(
                f"dataset.dir: {url} holds other files ({', '.join(foreign[:3])}) and no dataset; "
                "give an empty or new place with dataset.dir="
            )
        take_copy(folder, sizes, fresh=True)
        one = Publication(Path(os.path.abspath(folder)), store, lock, token, apart)
        with outlet(one.folder, one.pass_on):
            yield one
