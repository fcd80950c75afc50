"""Bags opened and written by the library rosbags, with its errors as lines of ours."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from simnfnd.factory.errors import FrameError
from simnfnd.factory.recordings.ros_messages import digest_of, typestore
from simnfnd.factory.recordings.rosbag_bounds import (
    bound_the_library,
    check_files,
    counted,
    unpacked_zstd,
)

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.rosbag2 import Writer as Writer2

    Reader = Reader1 | Reader2
    Writer = Writer1 | Writer2
    Message = tuple[Connection, int, bytes]

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
