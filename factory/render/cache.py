"""Renders on disk: each frame is rendered once, however many datasets are made of it.

One file an entry, written whole or not at all, with checksums: an entry that was damaged is
removed when it is met, and made again.  The file's time is when it was last used.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass as plain_dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from ..files import check_writable, explain_os_errors, remove_stale_temporaries, write_atomically
from ..settings import STRICT
from ..small_files import read_regular
from .view import View, decode, encode

_SUFFIX = ".view"
_MOST_BYTES = 1 << 27
# Room made at once, so that a full cache does not have to be gone through for every entry.
_EVICT_TO = 0.9


@dataclass(frozen=True, config=STRICT)
class CacheSettings:
    """Keys of the `cache` group.

    enabled: keep renders for later runs; else they last until the run ends.
    dir: folder of the cache.  max_bytes: when it holds more, what was not used for longest goes.
    """

    enabled: bool = True
    dir: Annotated[str, Field(min_length=1)] = "outputs/cache"
    max_bytes: Annotated[int, Field(ge=1)] = 20_000_000_000

    @property
    def folder(self) -> Path:
        """`dir` as an absolute path: workers may have another working folder."""
        return Path(os.path.abspath(Path(self.dir).expanduser()))


@plain_dataclass(frozen=True)
class Entry:
    """One file of the cache."""

    key: str
    path: Path
    bytes: int
    used_ns: int


class Cache:
    """The entries below one folder; any number of processes may use it at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def check(self) -> None:
        """Raise FactoryError with one line when the folder cannot be written."""
        check_writable(self.folder, "cache.dir")

    def holds(self, key: str) -> bool:
        """Whether there is an entry (whole or not)."""
        return self._path(key).exists()

    def get(self, key: str) -> View | None:
        """The entry, or None when it is absent or was damaged (and is now removed)."""
        path = self._path(key)
        view = _whole(path)
        if view is not None:
            with suppress(OSError):  # a cache that others own may be read only
                os.utime(path)
        return view

    def put(self, key: str, view: View) -> int:
        """Store an entry; returns its bytes.  Raises FactoryError when there is no room."""
        content = encode(view)
        path = self._path(key)
        with explain_os_errors(path.parent, "cache.dir"):
            path.parent.mkdir(parents=True, exist_ok=True)
        # Its checksums tell what a power cut left half done, so waiting for the disk is needless.
        write_atomically(path, content, durable=False, key="cache.dir")
        return len(content)

    def entries(self) -> Iterator[Entry]:
        """All entries; those that vanish meanwhile are left out."""
        for path in sorted(self.folder.glob(f"??/*{_SUFFIX}")):
            try:
                status = path.stat()
            except FileNotFoundError:
                continue
            yield Entry(path.stem, path, status.st_size, status.st_mtime_ns)

    def is_whole(self, entry: Entry) -> bool:
        """Whether an entry can be read; one that cannot is removed."""
        return _whole(entry.path) is not None

    def evict(self, max_bytes: int) -> int:
        """When there is more than `max_bytes`, remove what was unused longest; returns bytes left.

        Temp files of dead writers go, too.
        """
        for folder in self.folder.glob("??"):
            remove_stale_temporaries(folder)
        entries = sorted(self.entries(), key=lambda entry: (entry.used_ns, entry.key))
        total = sum(entry.bytes for entry in entries)
        if total <= max_bytes:
            return total
        for entry in entries:
            if total <= _EVICT_TO * max_bytes:
                break
            entry.path.unlink(missing_ok=True)
            total -= entry.bytes
        return total

    def clear(self) -> int:
        """Remove every entry; returns how many there were."""
        entries = list(self.entries())
        for entry in entries:
            with explain_os_errors(entry.path, "cache.dir"):
                entry.path.unlink(missing_ok=True)
        return len(entries)

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}{_SUFFIX}"


def _whole(path: Path) -> View | None:
    """The entry of this file, or None when it is absent or damaged; then it is removed."""
    try:
        return decode(read_regular(path, _MOST_BYTES))
    except (OSError, ValueError):
        path.unlink(missing_ok=True)
        return None


class Limit:
    """Keeps a cache within its size while it grows: call it with the bytes that were added."""

    def __init__(self, settings: CacheSettings) -> None:
        self._cache, self._max_bytes = Cache(settings.folder), settings.max_bytes
        self._total: int | None = None

    def __call__(self, added_bytes: int) -> None:
        """Evict when there is too much.  Looks at the folder at the first call and then."""
        if added_bytes == 0:
            return
        if self._total is None:
            self._total = self._cache.evict(self._max_bytes)
            return
        self._total += added_bytes
        if self._total > self._max_bytes:
            self._total = self._cache.evict(self._max_bytes)
