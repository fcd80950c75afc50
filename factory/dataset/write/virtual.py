"""Virtual datasets over many shards, in little memory.

HDF5 holds some 4 kB of every shard of a virtual dataset, four times while it makes one.  What it
writes of a shard are 90 bytes, an entry in a list that lies in one piece in the file
(H5D__virtual_store_layout): a version, the number of entries, the entries, a checksum.  So it is
asked for the entries of some shards at a time, in a file of their own; the index gets a dataset
whose one entry has a name that makes its list just as long, and the true list is put there in the
finished file.  It is the file that HDF5 writes when it is asked for all at once.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import Any

import h5py
import numpy as np

from ..format.manifest import ShardInfo
from ..format.schema import LIBRARY_VERSIONS

# Entries that HDF5 holds at a time: 4 MB of them.
_PART = 256
# Version and number of entries; before them stands the size of the list, after them a checksum.
_HEAD = struct.Struct("<BQ")
_SIZE, _SUM = struct.Struct("<Q"), struct.Struct("<I")


class VirtualStacks:
    """Makes the virtual datasets of an index; what they hold is in place after `filled`."""

    def __init__(self, index: h5py.File) -> None:
        self._index = index
        self._lists: dict[bytes, bytes] = {}  # name of the one entry -> the list in its place

    def add(
        self,
        name: str,
        source: str,
        shards: Sequence[ShardInfo],
        shape: tuple[int, ...],
        dtype: np.dtype[Any],
    ) -> h5py.Dataset:
        """A dataset put together of that of each shard; what `h5py.VirtualLayout` does.

        shape: of one sample.
        """
        stack = _Stack(source, (sum(shard.samples for shard in shards), *shape), dtype)
        found = _list_of(stack, shards) if len(shards) > _PART else None
        if found is None:
            return stack.made(self._index, name, _pieces(shards))
        stand_in = f"{len(self._lists)}/"
        plain = _written(stack, [(stand_in, 0, stack.samples)])
        assert plain is not None, "HDF5 wrote lists of shards a moment ago"
        stand_in = stand_in.ljust(len(stand_in) + len(found) - len(plain), "-")
        self._lists[stand_in.encode()] = found
        return stack.made(self._index, name, [(stand_in, 0, stack.samples)])

    def filled(self, content: bytes) -> bytes:
        """The bytes of the finished file with the lists in place."""
        view, parts, done = memoryview(content), [], 0
        for stand_in, found in self._lists.items():  # in the order in which they were written
            at = content.index(stand_in + b"\0", done) - _HEAD.size
            if content[at - _SIZE.size : at + _HEAD.size] != _framed(len(found), 1):
                raise RuntimeError(f"HDF5 {h5py.version.hdf5_version}: list of shards not found")
            parts += [view[done:at], memoryview(found)]
            done = at + len(found)
        return b"".join((*parts, view[done:]))


Piece = tuple[str, int, int]
"""Path of a shard, its first sample in the dataset, and its samples."""


class _Stack:
    """A virtual dataset to be made.  source: its name in the shards.  shape: of all of it."""

    def __init__(self, source: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.source, self.shape, self.samples = source.encode(), shape, shape[0]
        self._type = h5py.h5t.py_create(dtype, logical=True)

    def made(self, file: h5py.File, name: str, pieces: Sequence[Piece]) -> h5py.Dataset:
        layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        layout.set_layout(h5py.h5d.VIRTUAL)
        layout.set_obj_track_times(False)
        place = h5py.h5s.create_simple(self.shape)
        sample, origin = self.shape[1:], (0,) * (len(self.shape) - 1)
        whole: dict[int, h5py.h5s.SpaceID] = {}  # of a shard, by its samples
        for path, start, samples in pieces:
            size = (samples, *sample)
            if samples not in whole:
                whole[samples] = h5py.h5s.create_simple(size)
            place.select_hyperslab((start, *origin), size)
            # Relative to the folder of the index itself, so the dataset can be moved.
            layout.set_virtual(place, path.encode(), self.source, whole[samples])
        place.select_all()
        group, _, own = name.rpartition("/")
        parent = file.require_group(group) if group else file
        return h5py.Dataset(
            h5py.h5d.create(parent.id, own.encode(), self._type, place, dcpl=layout)
        )


def _pieces(shards: Sequence[ShardInfo]) -> list[Piece]:
    found, start = [], 0
    for shard in shards:
        found.append((shard.path, start, shard.samples))
        start += shard.samples
    return found


def _list_of(stack: _Stack, shards: Sequence[ShardInfo]) -> bytes | None:
    """The list of all shards; None when this HDF5 writes it in another form."""
    parts = []
    for part in _parts(_pieces(shards)):
        written = _written(stack, part)
        if written is None:
            return None
        parts.append(written[_HEAD.size : -_SUM.size])
    content = b"".join((_HEAD.pack(0, len(shards)), *parts))
    return content + _SUM.pack(_lookup3(content))


def _parts(pieces: Sequence[Piece]) -> Iterator[Sequence[Piece]]:
    return (pieces[k : k + _PART] for k in range(0, len(pieces), _PART))


def _written(stack: _Stack, pieces: Sequence[Piece]) -> bytes | None:
    """The list that HDF5 writes of these; None when it has another form."""
    with h5py.File(
        "part.h5", "w", driver="core", backing_store=False, libver=LIBRARY_VERSIONS
    ) as file:
        stack.made(file, "part", pieces)
        file.flush()
        content: bytes = file.id.get_file_image()
    at = content.find(b"%s\0%s\0" % (pieces[0][0].encode(), stack.source)) - _HEAD.size
    if at < _SIZE.size:
        return None
    (size,) = _SIZE.unpack_from(content, at - _SIZE.size)
    found = content[at : at + size]
    framed = content[at - _SIZE.size : at + _HEAD.size] == _framed(size, len(pieces))
    whole = len(found) == size > _HEAD.size + _SUM.size
    if not (framed and whole and _SUM.pack(_lookup3(found[: -_SUM.size])) == found[-_SUM.size :]):
        return None
    return found


def _framed(size: int, entries: int) -> bytes:
    return _SIZE.pack(size) + _HEAD.pack(0, entries)


def _lookup3(content: bytes) -> int:
    from .checksum_loops import lookup3

    return lookup3(content)
