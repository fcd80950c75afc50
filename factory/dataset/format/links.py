"""Objects of a shard that lie in its file: no link is followed that could lead out of it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import h5py

from ...errors import FactoryError


def object_inside(file: h5py.File, name: str) -> Any:
    """The object at `name`; links that could lead out of the file are refused on the way."""
    for part in _prefixes(name):
        if not exists(file, part):
            raise FactoryError(f"dataset /{part} is absent; generate the shard again")
        # Not h5py's own `in` and `get`: they open the file that an external link names.
        if file.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
            raise FactoryError(f"/{part} is a link to elsewhere; not followed")
    return file[name]


def dataset_inside(file: h5py.File, name: str) -> h5py.Dataset:
    """A dataset that lies in this very file."""
    found = object_inside(file, name)
    if not isinstance(found, h5py.Dataset):
        raise FactoryError(f"/{name} is no dataset; generate the shard again")
    plist = found.id.get_create_plist()
    if plist.get_layout() == h5py.h5d.VIRTUAL or plist.get_external_count():
        raise FactoryError(f"/{name} keeps its data in another file; not followed")
    return found


def exists(file: h5py.File, name: str) -> bool:
    """Whether there is a link of that name, whatever it leads to."""
    return bool(file.id.links.exists(name.encode()))


def _prefixes(name: str) -> Iterator[str]:
    parts = name.split("/")
    return ("/".join(parts[: count + 1]) for count in range(len(parts)))
