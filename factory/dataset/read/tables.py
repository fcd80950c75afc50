"""The sample tables of many shards, which `meta` is made of.

Of a large shard that lies far away the pieces alone are fetched that hold its table, some hundred
kilobytes; what came of it is kept beside the copy, so that the next reader fetches nothing.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ...files import write_atomically
from ...isolated import look_at
from ...storage.copies import url_of
from ...storage.store import Store
from ..format.layout import check_shard
from ..format.manifest import ShardInfo
from .reader import read_attributes, reading
from .stream import THREADS

Rows = npt.NDArray[np.void]
Piece = tuple[int, bytes]

# What HDF5 needs of a shard stands at its beginning and at its end, pictures between them.
_HEAD_BYTES, _TAIL_BYTES = 192 << 10, 128 << 10
_STEP_BYTES = 64 << 10
# Of a smaller one the whole costs hardly more.
_LARGE_BYTES = 4 * (_HEAD_BYTES + _TAIL_BYTES)
_TRIES = 8
_MOST_KEPT_BYTES = 1 << 31


class Table(NamedTuple):
    """/meta of one shard, (N,), and (H, W) of its pictures."""

    rows: Rows
    shape: tuple[int, int]
    split: str


def read_tables(
    paths: Sequence[Path],
    infos: Mapping[Path, ShardInfo],
    accept: Callable[[Path, h5py.File], None],
) -> Iterator[Table]:
    """The tables in the order of the shards.

    accept: raises FactoryError for an open shard that is not to be read.
    Raises FactoryError when a shard cannot be read, and what `accept` raises.
    """

    def table(path: Path) -> Table:
        if found := _by_pieces(path, infos.get(path)):
            return found
        with reading(path) as file:
            accept(path, file)
            return _table(file)

    if not paths or url_of(paths[0].parent.parent) is None:
        yield from map(table, paths)
        return
    threads = ThreadPoolExecutor(THREADS, "tables")
    try:
        yield from threads.map(table, paths)
    finally:
        threads.shutdown(wait=True, cancel_futures=True)


def kept_rows(folder: Path, paths: Sequence[Path], infos: Mapping[Path, ShardInfo]) -> Rows | None:
    """The tables of just these shards as `keep_rows` left them; None when it did not."""
    path = _place(folder, paths, infos)
    if path is None or not path.is_file() or path.stat().st_size > _MOST_KEPT_BYTES:
        return None
    with suppress(OSError, ValueError, EOFError):
        rows: Rows = np.load(path, allow_pickle=False)
        if rows.dtype.names and rows.shape == (sum(infos[one].samples for one in paths),):
            return rows
    return None


def keep_rows(
    folder: Path, paths: Sequence[Path], infos: Mapping[Path, ShardInfo], rows: Rows
) -> None:
    """Keep them beside the copy of a URL, in place of those of other shards of the split."""
    path = _place(folder, paths, infos)
    if path is None:
        return
    content = io.BytesIO()
    # h5py notes the encoding of text in the dtype, for which this format has no place.
    plain = np.dtype([(name, rows.dtype[name].str) for name in rows.dtype.names or ()])
    np.save(content, rows.view(plain), allow_pickle=False)
    with suppress(FactoryError):  # it would save time, no more
        for old in folder.glob(f"{path.stem.rpartition('-')[0]}-*.npy"):
            old.unlink(missing_ok=True)
        write_atomically(path, content.getvalue(), durable=False)


def _place(folder: Path, paths: Sequence[Path], infos: Mapping[Path, ShardInfo]) -> Path | None:
    if url_of(folder) is None or not all(path in infos for path in paths):
        return None
    text = "\n".join(f"{infos[path].path} {infos[path].sha256}" for path in paths)
    digest = hashlib.blake2b(text.encode(), digest_size=12).hexdigest()
    splits = "-".join(dict.fromkeys(infos[path].split for path in paths))
    return folder / f".tables-{splits}-{digest}.npy"


def _table(file: h5py.File) -> Table:
    height, width = file["noisy"].shape[1:]
    return Table(file["meta"][()], (height, width), str(file.attrs["split"]))


def _by_pieces(path: Path, info: ShardInfo | None) -> Table | None:
    """The table of a large shard that is not here; None where the whole has to be fetched."""
    url = url_of(path.parent.parent)
    if url is None or info is None or info.bytes < _LARGE_BYTES or path.exists():
        return None
    store = Store(url)

    def piece(start: int, end: int) -> Piece:
        content = store.get(info.path, start, min(end, info.bytes))
        return start, content or b""

    pieces = [piece(0, _HEAD_BYTES), piece(info.bytes - _TAIL_BYTES, info.bytes)]
    # Any fault is told by whoever reads the whole.
    with suppress(FactoryError):
        for _ in range(_TRIES):
            kind, *found = look_at(path, look_at_pieces, info.bytes, pieces)
            if kind == "table":
                rows, (height, width), split = found
                sound = len(rows) == info.samples and split == info.split
                return Table(rows, (height, width), split) if sound else None
            start, end = found
            first, last = start // _STEP_BYTES, -(-end // _STEP_BYTES)
            pieces.append(piece(first * _STEP_BYTES, last * _STEP_BYTES))
    return None


def look_at_pieces(size: int, pieces: Sequence[Piece]) -> tuple[Any, ...]:
    """("table", ...) of a shard of `size` bytes, or ("missing", first byte, end) of what it takes.

    For a process of its own: pieces are a stranger's.  Raises FactoryError when it is damaged.
    """
    known = _Pieces(size, pieces)
    try:
        with h5py.File(known, "r", rdcc_nbytes=0) as file:
            check_shard(file)
            read_attributes(file)
            return "table", *_table(file)
    except Exception as error:
        # HDF5 tells of a failed read in words of its own.
        if known.missing:
            return "missing", *known.missing
        raise FactoryError("damaged") from error


class _Pieces(io.RawIOBase):
    """A file of which some pieces are known.

    missing: (first byte, end) of the first read beyond them.
    """

    def __init__(self, size: int, pieces: Sequence[Piece]) -> None:
        self._size, self._pieces, self._at = size, pieces, 0
        self.missing: tuple[int, int] | None = None

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """As of any file."""
        self._at = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence] + offset
        return self._at

    def tell(self) -> int:
        """As of any file."""
        return self._at

    def readinto(self, target: Any) -> int:
        """As of any file; raises OSError beyond what is known."""
        count = min(len(target), max(0, self._size - self._at))
        for start, content in self._pieces:
            if start <= self._at and self._at + count <= start + len(content):
                first = self._at - start
                target[:count] = content[first : first + count]
                self._at += count
                return count
        self.missing = self.missing or (self._at, self._at + count)
        raise OSError("not known")
