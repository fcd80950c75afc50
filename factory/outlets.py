"""Folders whose files also go elsewhere: what is written whole there is put there, too.

The registry alone; `simnfnd.factory.storage` has the outlets.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Protocol


class Outlet(Protocol):
    """Where the files of a folder go."""

    @property
    def folder(self) -> Path:
        """The folder, absolute."""

    def put(self, path: Path, content: bytes) -> None:
        """A file of the folder was written.  Raises FactoryError when it cannot be passed on."""

    def remove(self, path: Path) -> None:
        """A file of the folder was removed, or was found absent."""

    def names(self) -> list[str]:
        """The shards that are there, below the folder, with forward slashes."""


# Of this process.
_outlets: list[Outlet] = []


@contextmanager
def outlet(one: Outlet | None) -> Iterator[None]:
    """Within the block, what this process writes into the folder goes through this one, too."""
    if one is None:
        yield
        return
    _outlets.append(one)
    try:
        yield
    finally:
        _outlets.remove(one)


def put_out(path: Path, content: bytes | None = None) -> None:
    """Pass a file on that was written; without `content` it is read."""
    for one in _of(path):
        one.put(path, path.read_bytes() if content is None else content)


def remove_file(path: Path) -> None:
    """Remove a file, which may be absent, here and wherever it went."""
    path.unlink(missing_ok=True)
    for one in _of(path):
        one.remove(path)


def names_outside(folder: Path, split: str) -> list[str]:
    """The shards of a split that lie wherever the files of this folder go."""
    return [name for one in _of(folder) for name in one.names() if name.startswith(f"{split}/")]


def _of(path: Path) -> list[Outlet]:
    if not _outlets:
        return []
    place = Path(os.path.abspath(path))
    return [one for one in _outlets if place.is_relative_to(one.folder)]
