"""Objects and axes of a shard, read from a file that may be damaged or a stranger's.

No link is followed that could lead out of the file.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import h5py
import numpy as np

from ...errors import FactoryError
from .schema import CAMERA_LAYERS, CHECKSUMS, Axis

ECHO_PLACE = "echoes/place"


def image_axes(stack: h5py.Dataset) -> tuple[Axis, Axis]:
    """Row and column axes of an image stack.  Raises FactoryError when one cannot be read."""
    return _axis(stack, 1), _axis(stack, 2)


def axis_names(stack: h5py.Dataset) -> tuple[str, ...]:
    """The names of both: what is asked of every layer of a shard, whose axes are the same.

    The pictures of the camera and the lists of echoes have none.
    """
    name = str(stack.name).lstrip("/")
    if name in CAMERA_LAYERS or name.startswith("echoes/"):
        return ()
    return str(stack.dims[1].label), str(stack.dims[2].label)


def _axis(stack: h5py.Dataset, dimension: int) -> Axis:
    # By its name: HDF5 dies of some numbers that stand in place of a reference.
    name, size = str(stack.dims[dimension].label), stack.shape[dimension]
    scale = dataset_inside(stack.file, f"axes/{name}")
    if scale.shape != (size,) or scale.dtype.kind not in "iuf":
        raise FactoryError(f"/axes/{name} does not have the {size} numbers of {stack.name}")
    units, about = (str(scale.attrs.get(key, "")) for key in ("units", "description"))
    return Axis(name, units, np.asarray(scale[()], dtype=np.float64), about)


def object_inside(file: h5py.File, name: str) -> Any:
    """The object at `name`; links that could lead out of the file are refused on the way."""
    for part in _prefixes(name):
        if not exists(file, part):
            raise FactoryError(f"dataset /{part} is absent; generate the shard again")
        # Not h5py's own `in` and `get`: they open the file that an external link names.
        if file.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
            raise FactoryError(f"/{part} is a link to elsewhere; not followed")
    return file[name]


def dataset_inside(file: h5py.File, name: str, *, chunks: bool = False) -> h5py.Dataset:
    """A dataset that lies in this very file, in one piece or in chunks as the schema has it.

    What lies in one piece is read as a whole, so it may not claim more bytes than the file has.
    """
    found = object_inside(file, name)
    if not isinstance(found, h5py.Dataset):
        raise FactoryError(f"/{name} is no dataset; generate the shard again")
    plist = found.id.get_create_plist()
    if plist.get_layout() == h5py.h5d.VIRTUAL or plist.get_external_count():
        raise FactoryError(f"/{name} keeps its data in another file; not followed")
    if chunks != (plist.get_layout() == h5py.h5d.CHUNKED):
        kept = "chunks" if chunks else "one piece"
        raise FactoryError(f"/{name}: the schema keeps it in {kept}; generate it again")
    claimed = int(np.prod(found.shape, dtype=np.float64)) * found.id.get_type().get_size()
    if not chunks and claimed > file.id.get_filesize():
        raise FactoryError(f"/{name} claims more bytes than the file has")
    return found


def echo_names(file: h5py.File) -> tuple[str, ...]:
    """Lists of echoes that versions before 0.4 could write, for h5py alone to read; mostly none.

    Raises FactoryError when one lies in another file.
    """
    listed = dataset_inside(file, CHECKSUMS).dtype.names if exists(file, CHECKSUMS) else None
    names = tuple(name for name in listed or () if name.startswith("echoes/"))
    for name in (ECHO_PLACE, *names) if names else ():
        dataset_inside(file, name)
    return names


def exists(file: h5py.File, name: str) -> bool:
    """Whether there is a link of that name, whatever it leads to."""
    return bool(file.id.links.exists(name.encode()))


def _prefixes(name: str) -> Iterator[str]:
    parts = name.split("/")
    return ("/".join(parts[: count + 1]) for count in range(len(parts)))
