"""Bags opened and written by the library rosbags, with its errors as lines of ours.

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
from .ros_messages import digest_of, typestore

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.rosbag2 import Writer as Writer2

    Reader = Reader1 | Reader2
    Writer = Writer1 | Writer2
    Message = tuple[Connection, int, bytes]

MOST_CHUNK = 256 * 2**20
"""Bytes that one chunk or message may unpack into; writers of bags make chunks of about 1 MB."""
MOST_RATIO = 200
"""How many times its size on disk, beyond MOST_CHUNK, a bag may give.

Raw pictures of a sonar are black for the most part and pack 5 to 50 times.
"""
_STEP = 2**20
# RIHS01 of a type of which neither the bag nor this program knows more than the name.
_UNKNOWN_DIGEST = "RIHS01_" + 64 * "0"


def is_bag_folder(folder: Path) -> bool:
    """Whether a folder is a bag of ROS 2: metadata.yaml beside files that hold messages."""
    return (folder / "metadata.yaml").is_file() and any(
        {".db3", ".mcap"} & set(file.suffixes) for file in folder.iterdir()
    )


@contextmanager
def explained(what: str, passing: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Any error of the library as a FrameError: it does not say which ones damage leads to.

    passing: errors that are left as they are.
    """
    try:
        yield
    except passing:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise FrameError(f"{what}: cannot be read, it is damaged or no bag ({reason})") from error


def _opened(path: Path, version: int) -> Reader:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    bound_the_library()
    check_files(path)
    with explained(str(path)):
        reader = Reader1(path) if version == 1 else Reader2(path)
        reader.open()
        return reader


@contextmanager
def reading(path: Path, version: int) -> Iterator[Reader]:
    """A bag of ROS 1 or 2, opened.  Raises FrameError when that cannot be."""
    reader = _opened(path, version)
    try:
        yield reader
    finally:
        reader.close()


def messages(path: Path, reader: Reader, connections: Sequence[Connection]) -> Iterator[Message]:
    """(connection, nanoseconds since 1970, content) of all messages of some connections, in order.

    Raises FrameError at damage.
    """
    with explained(str(path)):
        found = _contents(reader, connections)
    return counted(path, size_of(path), _explained_one_by_one(path, found))


def _contents(reader: Reader, connections: Sequence[Connection]) -> Iterator[Message]:
    """Messages, those packed one by one unpacked here: the library would do it without bound."""
    storage = getattr(reader, "storage", None)
    if storage is None or storage.metadata.compression_mode != "message":
        return reader.messages(connections)
    storage.metadata = storage.metadata._replace(compression_mode=None)
    found = reader.messages(connections)
    return ((one, time_ns, unpacked_zstd(data)) for one, time_ns, data in found)


def _explained_one_by_one(path: Path, found: Iterator[Message]) -> Iterator[Message]:
    while True:
        with explained(str(path)):
            message = next(found, None)
        if message is None:
            return
        yield message


def size_of(path: Path) -> int:
    """Bytes of a bag."""
    files = [path] if path.is_file() else [one for one in path.iterdir() if one.is_file()]
    return sum(file.stat().st_size for file in files)


@contextmanager
def writing(source: Path, reader: Reader, target: Path) -> Iterator[Writer]:
    """A writer of the same kind of bag, compressed alike."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    writer: Writer
    if isinstance(reader, Reader1):
        from rosbags.rosbag1.reader import Compression, decompressors

        writer = Writer1(target)
        used = {chunk.decompressor for chunk in reader.chunks.values()}
        for kind in (Compression.BZ2, Compression.LZ4):
            if decompressors[kind.value] in used:
                writer.set_compression(Writer1.CompressionFormat[kind.name])
    else:
        files = [source] if source.is_file() else list(source.iterdir())
        mcap = any(".mcap" in file.suffixes for file in files)
        plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
        writer = Writer2(target, version=8, storage_plugin=plugin)
        if reader.compression_mode:
            mode = CompressionMode[reader.compression_mode.upper()]
            writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        yield writer


def added(writer: Writer, one: Connection) -> Connection:
    """The connection in another bag."""
    from rosbags.interfaces import ConnectionExtRosbag1
    from rosbags.rosbag1 import Writer as Writer1

    ext, definition = one.ext, one.msgdef.data
    if isinstance(writer, Writer1):
        assert isinstance(ext, ConnectionExtRosbag1)
        return writer.add_connection(
            one.topic, one.msgtype, msgdef=definition, md5sum=one.digest or "*",
            callerid=ext.callerid, latching=ext.latching,
        )  # fmt: skip
    assert not isinstance(ext, ConnectionExtRosbag1)
    digest = one.digest or (
        digest_of(one.msgtype, 2) if one.msgtype in typestore(2).fielddefs else _UNKNOWN_DIGEST
    )
    return writer.add_connection(
        one.topic, one.msgtype, msgdef=definition, rihs01=digest,
        serialization_format=ext.serialization_format,
        offered_qos_profiles=ext.offered_qos_profiles,
    )  # fmt: skip


def allowance(size: int) -> int:
    """Bytes that a bag of `size` bytes may unpack into."""
    return MOST_CHUNK + MOST_RATIO * size


def bound_the_library() -> None:
    """Let no chunk that rosbags reads from now on unpack into more than MOST_CHUNK bytes."""
    from rosbags.rosbag1.reader import decompressors
    from rosbags.rosbag2.storage_mcap import DECOMPRESSORS

    decompressors.update(bz2=_unpacked_bz2, lz4=_unpacked_lz4)
    DECOMPRESSORS.update(
        lz4=lambda content, _: _unpacked_lz4(content),
        zstd=lambda content, _: unpacked_zstd(content),
    )


def unpacked_zstd(content: bytes) -> bytes:
    """A chunk or message.  Raises ValueError when it is larger than MOST_CHUNK, or damaged."""
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
        part = one.decompress(content, max_length=MOST_CHUNK - total + 1)
        total += len(part)
        if total > MOST_CHUNK:
            raise ValueError(f"it unpacks into more than {MOST_CHUNK:,} bytes")
        if not one.eof:
            raise ValueError("compressed data end too early")
        parts.append(part)
        content = one.unused_data or b""
    return b"".join(parts)


def check_files(path: Path) -> None:
    """Refuse files that make much of little before the library opens them.

    Raises FrameError for a bag whose files, packed as a whole, unpack beyond `allowance`, and for a
    database whose tables are no tables: a view can go on for ever.
    """
    files = [path] if path.is_file() else sorted(one for one in path.iterdir() if one.is_file())
    for file in files:
        if file.suffix == ".zstd":
            _count(file)
        elif file.suffix == ".db3":
            _check_tables(file)


def _count(file: Path) -> None:
    most, total = allowance(file.stat().st_size), 0
    try:
        with zstd.open(file, "rb") as opened:
            while part := opened.read(_STEP):
                total += len(part)
                if total > most:
                    raise FrameError(
                        f"{file}: unpacks into more than {most:,} bytes, {MOST_RATIO} times its "
                        "size; if it is sound, unpack it with `zstd -d` and take the result"
                    )
    except (zstd.ZstdError, EOFError, OSError) as error:
        raise FrameError(f"{file}: cannot be read, it is damaged or no bag ({error})") from error


def _check_tables(file: Path) -> None:
    try:
        with file.open("rb") as opened:
            if opened.read(16) != b"SQLite format 3\0":
                return
        database = sqlite3.connect(f"{file.resolve().as_uri()}?mode=ro", uri=True)
        try:
            found = database.execute("SELECT type, sql FROM sqlite_master LIMIT 100").fetchall()
        finally:
            database.close()
    except (sqlite3.Error, OSError) as error:
        raise FrameError(f"{file}: cannot be read, it is damaged or no bag ({error})") from error
    for kind, sql in found:
        words = " ".join(str(sql).upper().replace("(", " ( ").split())
        if kind not in ("table", "index") or "VIRTUAL TABLE" in words or " AS ( " in words:
            raise FrameError(f"{file}: holds a {kind} that computes; no bag has that")


def counted(path: Path, size: int, contents: Iterator[Any]) -> Iterator[Any]:
    """The same (connection, time, content), while together they keep to `allowance`.

    Raises FrameError at the first beyond.
    """
    most = allowance(size)
    for message in contents:
        most -= len(message[2])
        if most < 0:
            raise FrameError(
                f"{path}: its messages are more than {allowance(size):,} bytes, {MOST_RATIO} times "
                "its size; it was made to fill memory or disk"
            )
        yield message
