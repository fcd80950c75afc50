"""Bags whose index is missing, because the recorder was stopped: read from the front.

A bag of ROS 1 (https://wiki.ros.org/Bags/Format/2.0) and an MCAP file (https://mcap.dev/spec) are
rows of records that say how long they are, some of them chunks of further records.  All whole
records are read in the order of the file, those of a last chunk that is cut short, too.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

from .base import ALWAYS_BYTES

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

_BAG_MAGIC = b"#ROSBAG V2.0\n"
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_MESSAGE = 2
_CHUNK = 5
_CONNECTION = 7
_MCAP_SCHEMA = 3
_MCAP_CHANNEL = 4
_MCAP_MESSAGE = 5
_MCAP_CHUNK = 6
_MOST_FIELDS = 1000


class Message(NamedTuple):
    """A stored message: number of its connection, nanoseconds since 1970, content."""

    connection: int
    time_ns: int
    content: bytes


class StoredMessage(NamedTuple):
    """A message as the readers of rosbags give it: its connection, when it was recorded, its bytes.

    time_ns: nanoseconds since 1970.
    """

    connection: Connection
    time_ns: int
    content: bytes


class CutBag:
    """A reader of a `.bag` or `.mcap` file without its index, as those of rosbags are.

    connections: of the topics, with how many messages each has.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.connections: list[Connection] = []

    def open(self) -> None:
        """Counts the whole messages.  May raise nearly anything."""
        connections: dict[int, Connection] = {}
        counts: dict[int, int] = {}
        for message in self._messages(connections):
            counts[message.connection] = counts.get(message.connection, 0) + 1
        self.connections = [
            connection._replace(msgcount=counts[number])
            for number, connection in connections.items()
            if number in counts
        ]

    def messages(self, connections: Collection[Connection]) -> Iterator[StoredMessage]:
        """The messages of these connections, in order."""
        wanted = {connection.id: connection for connection in connections}
        for message in self._messages({}):
            if message.connection in wanted:
                yield StoredMessage(wanted[message.connection], message.time_ns, message.content)

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def _messages(self, connections: dict[int, Connection]) -> Iterator[Message]:
        """All whole messages; `connections` gets the connections on the way."""
        with self._path.open("rb") as file:
            magic = file.read(len(_BAG_MAGIC))
            if magic == _BAG_MAGIC:
                yield from _messages_of_bag(file, connections)
            elif magic.startswith(_MCAP_MAGIC):
                file.seek(len(_MCAP_MAGIC))
                yield from _messages_of_mcap(file, connections, {})


def _messages_of_bag(file: IO[bytes], connections: dict[int, Connection]) -> Iterator[Message]:
    while (header := _fields_at(file)) is not None:
        content, is_whole = _sized(file, 4)
        kind = header.get("op", b"\0")[0]
        if kind == _CHUNK:
            compression = header.get("compression", b"none").decode()
            yield from _messages_of_bag(BytesIO(_unpacked(content, compression)), connections)
        if not is_whole:
            return
        number = int.from_bytes(header.get("conn", b""), "little")
        if kind == _CONNECTION:
            about = _fields_of(content)
            connections.setdefault(number, _bag_connection(number, header | about))
        elif kind == _MESSAGE:
            seconds, nanoseconds = struct.unpack("<2I", header["time"])
            yield Message(number, seconds * 1_000_000_000 + nanoseconds, content)


def _fields_at(file: IO[bytes]) -> dict[str, bytes] | None:
    """The header of the next record of a bag; None at the end."""
    content, is_whole = _sized(file, 4)
    return _fields_of(content) if is_whole and content else None


def _fields_of(content: bytes) -> dict[str, bytes]:
    """Names and values, each with its length before it and `=` between them."""
    fields: dict[str, bytes] = {}
    stream = BytesIO(content)
    for _ in range(_MOST_FIELDS):
        field, is_whole = _sized(stream, 4)
        if not is_whole or not field:
            break
        name, _, value = field.partition(b"=")
        fields[name.decode("latin-1")] = value
    return fields


def _bag_connection(number: int, fields: dict[str, bytes]) -> Connection:
    """A connection of rosbags from the fields of a record of a ROS 1 bag."""
    from rosbags.interfaces import (
        Connection,
        ConnectionExtRosbag1,
        MessageDefinition,
        MessageDefinitionFormat,
    )

    package, _, name = fields["type"].decode().rpartition("/")
    definition = fields.get("message_definition", b"").decode()
    callerid = fields.get("callerid")
    latching = fields.get("latching")
    return Connection(
        number,
        fields["topic"].decode(),
        f"{package}/msg/{name}",
        MessageDefinition(MessageDefinitionFormat.MSG, definition),
        fields.get("md5sum", b"").decode(),
        0,
        ConnectionExtRosbag1(
            None if callerid is None else callerid.decode(),
            None if latching is None else int(latching),
        ),
        None,
    )


def _messages_of_mcap(
    file: IO[bytes], connections: dict[int, Connection], schemas: dict[int, Any]
) -> Iterator[Message]:
    while kind := file.read(1):
        content, is_whole = _sized(file, 8)
        if kind[0] == _MCAP_CHUNK:
            records = _records_of_chunk(content)
            yield from _messages_of_mcap(BytesIO(records), connections, schemas)
        if not is_whole:
            return
        if kind[0] == _MCAP_SCHEMA:
            _add_schema(content, schemas)
        elif kind[0] == _MCAP_CHANNEL:
            _add_channel(content, schemas, connections)
        elif kind[0] == _MCAP_MESSAGE and len(content) >= 22:
            channel, _, time_ns, _ = struct.unpack_from("<HIQQ", content)
            yield Message(channel, time_ns, content[22:])


def _records_of_chunk(content: bytes) -> bytes:
    stream = BytesIO(content)
    stream.seek(28)  # behind two times, the size and the checksum
    compression, _ = _sized(stream, 4)
    records, _ = _sized(stream, 8)
    return _unpacked(records, compression.decode("latin-1") or "none")


def _add_schema(content: bytes, schemas: dict[int, Any]) -> None:
    from rosbags.rosbag2.storage_mcap import Schema

    stream = BytesIO(content[2:])
    name, encoding, definition = (_sized(stream, 4)[0].decode() for _ in range(3))
    (number,) = struct.unpack_from("<H", content)
    schemas[number] = Schema(number, name, encoding, definition)


def _add_channel(
    content: bytes, schemas: dict[int, Any], connections: dict[int, Connection]
) -> None:
    """Add the connection of a channel record of an MCAP file, if its schema came before."""
    from rosbags.interfaces import Connection, ConnectionExtRosbag2
    from rosbags.rosbag2.storage_mcap import get_msgdef, get_qos

    number, schema_number = struct.unpack_from("<2H", content)
    stream = BytesIO(content[4:])
    topic, encoding, metadata = (_sized(stream, 4)[0] for _ in range(3))
    schema = schemas.get(schema_number)
    if number in connections or schema is None:
        return
    extension = ConnectionExtRosbag2(encoding.decode(), get_qos(metadata))
    definition = get_msgdef(schema)
    connections[number] = Connection(
        number, topic.decode(), schema.name, definition, "", 0, extension, None
    )


def _sized(file: IO[bytes], length_bytes: int) -> tuple[bytes, bool]:
    """What follows its own length, and whether all of it is there."""
    field = file.read(length_bytes)
    if len(field) < length_bytes:
        return b"", False
    length = int.from_bytes(field, "little")
    content = file.read(min(length, _left_in(file)))
    return content, len(content) == length


def _left_in(file: IO[bytes]) -> int:
    """How many bytes follow."""
    place = file.tell()
    end = file.seek(0, 2)
    file.seek(place)
    return end - place


def _unpacked(content: bytes, compression: str) -> bytes:
    """The part of a chunk's content that is there.  Raises KeyError for an unknown compression."""
    unpackers: dict[str, Callable[[bytes], bytes]] = {
        "none": lambda packed: packed,
        "bz2": _unpacked_bz2,
        "lz4": _unpacked_lz4,
        "zstd": _unpacked_zstd,
    }
    return unpackers[compression](content)


def _unpacked_bz2(content: bytes) -> bytes:
    import bz2

    return bz2.BZ2Decompressor().decompress(content, ALWAYS_BYTES)


def _unpacked_lz4(content: bytes) -> bytes:
    import lz4.frame

    unpacked: bytes = lz4.frame.LZ4FrameDecompressor().decompress(content, ALWAYS_BYTES)
    return unpacked


def _unpacked_zstd(content: bytes) -> bytes:
    import sys

    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd
    return zstd.ZstdDecompressor().decompress(content, ALWAYS_BYTES)
