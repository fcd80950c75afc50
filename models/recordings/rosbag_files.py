"""Bags opened by the library rosbags, bounded in what they unpack to.

The library unpacks whatever it is given.  Here its tables of decompressors are filled with ones
that stop, files and messages are unpacked or counted by ourselves, and what a whole bag may give is
bounded by its size: a bag that was made to unpack into gigabytes is refused before it does.
"""

from __future__ import annotations

import bz2
import sqlite3
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...factory.errors import FrameError
from . import base
from .base import explained

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    Reader = Reader1 | Reader2
    Message = tuple[Connection, int, bytes]

_STEP = 2**20
_DAMAGED = "cannot be read, it is damaged or no bag"


@contextmanager
def reading(path: Path, version: int) -> Iterator[Reader]:
    """A bag of ROS 1 or 2, opened.  Raises FrameError when that cannot be."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    with explained(f"{path}: {_DAMAGED}", reason=True):
        _bound_the_library()
        for file in files_of(path):
            if file.suffix == ".zstd":
                with zstd.open(file, "rb") as opened:
                    _counted(path, file.stat().st_size, iter(lambda: opened.read(_STEP), b""))
            elif file.suffix == ".db3":
                _check_tables(file)
        reader = Reader1(path) if version == 1 else Reader2(path)
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


def messages(path: Path, reader: Reader, connections: Sequence[Connection]) -> Iterator[Message]:
    """(connection, nanoseconds since 1970, content) of all messages of some connections, in order.

    Raises FrameError at damage, and at the first message beyond what a bag may unpack to.
    """
    storage = getattr(reader, "storage", None)
    packed = False
    if storage is not None and storage.metadata.compression_mode == "message":
        packed = True  # the library would unpack them without bound
        storage.metadata = storage.metadata._replace(compression_mode=None)
    with explained(f"{path}: {_DAMAGED}", reason=True):
        most, total = base.most_streamed(size_of(path)), 0
        found = iter(reader.messages(connections))
    while True:
        with explained(f"{path}: {_DAMAGED}", reason=True):
            message = next(found, None)
            if message is None:
                return
            one, time_ns, content = message
            content = unpacked_zstd(content) if packed else content
        total += len(content)
        base.ask_bytes(f"{path}: its messages", total, most)
        yield one, time_ns, content


def files_of(path: Path) -> list[Path]:
    """The files of a bag."""
    if path.is_file():
        return [path]
    return sorted(one for one in path.iterdir() if one.is_file())


def size_of(path: Path) -> int:
    """Bytes of a bag."""
    return sum(file.stat().st_size for file in files_of(path))


def _bound_the_library() -> None:
    """Let no chunk that rosbags reads from now on unpack beyond `base.ALWAYS_BYTES`."""
    from rosbags.rosbag1.reader import decompressors
    from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

    decompressors.update(bz2=_unpacked_bz2, lz4=_unpacked_lz4)
    DECOMPRESSORS.update(
        lz4=lambda content, _: _unpacked_lz4(content),
        zstd=lambda content, _: unpacked_zstd(content),
    )


def unpacked_zstd(content: bytes) -> bytes:
    """A chunk or message.  Raises ValueError when it is too large, or damaged."""
    return _unpacked(content, zstd.ZstdDecompressor)


def _unpacked_bz2(content: bytes) -> bytes:
    return _unpacked(content, bz2.BZ2Decompressor)


def _unpacked_lz4(content: bytes) -> bytes:
    from lz4.frame import LZ4FrameDecompressor

    return _unpacked(content, LZ4FrameDecompressor)


def _unpacked(content: bytes, kind: Any) -> bytes:
    """All streams of `content`, one after another."""
    parts, total = [], 0
    while content:
        one = kind()
        part = one.decompress(content, max_length=base.ALWAYS_BYTES - total + 1)
        total += len(part)
        if total > base.ALWAYS_BYTES:
            raise ValueError(f"a part unpacks to more than {base.ALWAYS_BYTES:,} bytes")
        if not one.eof:
            raise ValueError("compressed data end too early")
        parts.append(part)
        content = one.unused_data or b""
    return b"".join(parts)


def _counted(path: Path, size: int, parts: Iterator[bytes]) -> None:
    most, total = base.most_streamed(size), 0
    for part in parts:
        total += len(part)
        base.ask_bytes(str(path), total, most)


def _check_tables(file: Path) -> None:
    """Raise FrameError for a database whose tables are none: a view can go on for ever."""
    with file.open("rb") as opened:
        if opened.read(16) != b"SQLite format 3\0":
            return
    database = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)
    try:
        found = database.execute("SELECT type, sql FROM sqlite_master LIMIT 100").fetchall()
    finally:
        database.close()
    for kind, sql in found:
        words = " ".join(str(sql).upper().replace("(", " ( ").split())
        if kind not in ("table", "index") or "VIRTUAL TABLE" in words or " AS ( " in words:
            raise FrameError(f"{file}: holds a {kind} that computes; no bag has that")
