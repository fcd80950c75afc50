"""Bags of ROS 1 (.bag) and ROS 2 (a folder, or one .mcap or .db3) by the library rosbags.

Frames are the messages of some topics; `rewrite` makes the same bag with other samples in them.
What a bag says of its message types is never run: see `ros_messages`.  Compressed bags unpack as
the library does, without a bound.
"""

from __future__ import annotations

import os
from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from ...factory.errors import FactoryError, FrameError
from ...factory.files import explain_os_errors
from .base import Frame, Recording, Samples, explained
from .ros_messages import (
    COMPRESSED,
    IMAGE,
    SONAR,
    digest_of,
    frame_of,
    typestore,
    with_samples,
)

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Reader as Reader2
    from rosbags.rosbag2 import Writer as Writer2

    Reader = Reader1 | Reader2
    Writer = Writer1 | Writer2

_DAMAGED = "cannot be read, it is damaged or no bag"
# RIHS01 of a type of which neither the bag nor this program knows more than the name.
_UNKNOWN_DIGEST = "RIHS01_" + 64 * "0"
_KINDS = (SONAR, IMAGE, COMPRESSED)


class RosBag(Recording):
    """A bag; a `Recording`.

    topics: whose messages are the frames.  Without, those of all sonars
    (marine_acoustic_msgs/ProjectedSonarImage), or else the only one with pictures
    (sensor_msgs/Image or CompressedImage).
    Frames are read in order; one by number is searched from where reading stands.
    """

    def __init__(self, path: Path, topics: Sequence[str] = ()) -> None:
        """Raises FactoryError when the bag cannot be read or has no such topics."""
        try:
            import cv2  # noqa: F401  (of the same extra)
            import rosbags  # noqa: F401  (an extra)
        except ImportError as error:
            raise FactoryError(
                f"{path}: reading bags needs {error.name}: pip install 'simnfnd[ros]'"
            ) from error
        super().__init__(path)
        self.version = 1 if path.is_file() and path.suffix.lower() == ".bag" else 2
        try:
            with _reading(path, self.version) as reader:
                found = list(reader.connections)
        except FrameError as error:
            raise FactoryError(str(error)) from error
        self.connections = _chosen(path, found, topics, self.version)
        self.topics = tuple(dict.fromkeys(one.topic for one in self.connections))
        # A message takes a byte at least, whatever the bag says.
        stated = sum(max(0, int(one.msgcount)) for one in self.connections)
        self._count = min(stated, sum(file.stat().st_size for file in _files(path)))
        if not self._count:
            raise FactoryError(f"{path}: holds no message on {', '.join(self.topics)}")
        self._next, self._frames = 0, self._all()

    def __len__(self) -> int:
        return self._count

    def _read(self, number: int) -> Frame:
        if number < self._next:
            self._next, self._frames = 0, self._all()
        for frame in self._frames:
            self._next = frame.number + 1
            if frame.number == number:
                return frame
        self._next = self._count
        raise FrameError(f"{self.path}: ends before frame {number}; it is cut short or damaged")

    def __iter__(self) -> Iterator[Frame]:
        number = -1
        for frame in self._all():
            number = frame.number
            yield frame
        if number < 0:
            raise FrameError(
                f"{self.path}: holds none of the messages that it names; it is damaged"
            )
        if number + 1 < self._count:
            self.warning = f"{self.path}: ends after {number + 1} of {self._count} frames"

    def close(self) -> None:
        """See `Recording`."""
        self._frames.close()

    def _all(self) -> Generator[Frame]:
        # A reader of its own, as two that read in turns would lose their places.
        with _reading(self.path, self.version) as reader:
            chosen = _same(reader.connections, self.connections)
            for number, (one, time_ns, data) in enumerate(_messages(self.path, reader, chosen)):
                message, what = self._message(one, data, number)
                yield frame_of(message, one.msgtype, number, time_ns * 1e-9, what)

    def _message(self, one: Connection, data: bytes, number: int) -> tuple[Any, str]:
        """A message, and how errors name it."""
        what = f"{self.path}: message {number} of {', '.join(self.topics)}"
        store = typestore(self.version)
        read = store.deserialize_ros1 if self.version == 1 else store.deserialize_cdr
        with explained(f"{what}: cannot be read, it is damaged", reason=True):
            return read(data, one.msgtype), what

    def rewrite(self, samples: Iterable[Samples], path: Path) -> None:
        """The same bag with other samples in its frames, as another file or folder.

        All else is copied: other topics, headers and stamps, the times of recording.
        samples: of each frame in order, in the shape and type of `Frame.samples`.
        Raises ValueError for samples of another shape, type or number, FrameError when the bag is
        damaged, FactoryError when `path` is there or cannot be written.
        """
        if path.exists() and (path.is_dir() or not path.is_file()):
            raise FactoryError(f"{path}: is there already; remove it, or give another --out")
        with explain_os_errors(path, "--out"):
            path.parent.mkdir(parents=True, exist_ok=True)
            with TemporaryDirectory(dir=path.parent, prefix=f".{path.name}.") as folder:
                # The library names the file of a ROS 2 bag as its folder.
                target = Path(folder) / (path.stem if self.path.is_file() else path.name)
                if self.version == 1:
                    target = target.with_suffix(".bag")
                with _reading(self.path, self.version) as reader:
                    self._write(reader, iter(samples), target)
                if self.version == 2 and self.path.is_file():
                    (target,) = (one for one in target.iterdir() if one.suffix in (".mcap", ".db3"))
                os.replace(target, path)

    def _write(self, reader: Reader, samples: Iterator[Samples], target: Path) -> None:
        store, damaged = typestore(self.version), f"{self.path}: cannot be copied"
        serialized = store.serialize_ros1 if self.version == 1 else store.serialize_cdr
        chosen = {one.id for one in _same(reader.connections, self.connections)}
        with _writing(self.path, reader, target) as writer:
            with explained(damaged, passing=OSError, reason=True):
                targets = {one.id: _added(writer, one) for one in reader.connections}
            number = 0
            for one, time_ns, data in _messages(self.path, reader, reader.connections):
                content: bytes | memoryview = data
                if one.id in chosen:
                    message, what = self._message(one, data, number)
                    new = next(samples, None)
                    if new is None:
                        raise ValueError(f"{self.path}: has more frames than samples were given")
                    message = with_samples(message, one.msgtype, new, what)
                    content = serialized(message, one.msgtype)
                    number += 1
                with explained(damaged, passing=OSError, reason=True):
                    writer.write(targets[one.id], time_ns, content)
        if next(samples, None) is not None:
            raise ValueError(f"{self.path}: has fewer frames than samples were given")


@contextmanager
def _reading(path: Path, version: int) -> Iterator[Reader]:
    """A bag of ROS 1 or 2, opened.  Raises FrameError when that cannot be."""
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    with explained(f"{path}: {_DAMAGED}", reason=True):
        reader = Reader1(path) if version == 1 else Reader2(path)
        reader.open()
    try:
        yield reader
    finally:
        reader.close()


def _messages(
    path: Path, reader: Reader, connections: Sequence[Connection]
) -> Iterator[tuple[Connection, int, bytes]]:
    """(connection, nanoseconds since 1970, content) of all messages of some connections, in order.

    Raises FrameError at damage.
    """
    with explained(f"{path}: {_DAMAGED}", reason=True):
        found = iter(reader.messages(connections))
    while True:
        with explained(f"{path}: {_DAMAGED}", reason=True):
            message = next(found, None)
        if message is None:
            return
        yield message


def _files(path: Path) -> list[Path]:
    return [path] if path.is_file() else [one for one in path.iterdir() if one.is_file()]


def _same(here: Sequence[Connection], wanted: Sequence[Connection]) -> list[Connection]:
    """Those of another reader of the same bag."""
    numbers = {one.id for one in wanted}
    return [one for one in here if one.id in numbers]


def _chosen(
    path: Path, connections: Sequence[Connection], topics: Sequence[str], version: int
) -> list[Connection]:
    """The connections whose messages are the frames."""
    fit = [one for one in connections if one.msgtype in _KINDS]
    names = ", ".join(dict.fromkeys(one.topic[:80] for one in fit)) or "none"
    absent = [topic for topic in topics if topic not in {one.topic for one in fit}]
    if absent:
        raise FactoryError(f"{path}: has no pictures on the topic {absent[0]}; it has {names}")
    if not fit:
        kinds = "ProjectedSonarImage, Image or CompressedImage"
        raise FactoryError(f"{path}: holds no topic with pictures ({kinds})")
    sonars = [one for one in fit if one.msgtype == SONAR]
    chosen = [one for one in fit if one.topic in topics] or sonars or fit
    if not topics and not sonars and len({one.topic for one in fit}) > 1:
        raise FactoryError(
            f"{path}: has pictures on several topics ({names}); say with --topic which of them are "
            "of a sonar"
        )
    for one in chosen:
        if one.digest and one.digest not in ("*", digest_of(one.msgtype, version)):
            raise FactoryError(
                f"{path}: {one.topic} has another {one.msgtype} than this program knows (its "
                f"fingerprint is {one.digest[:80]})"
            )
    return chosen


@contextmanager
def _writing(source: Path, reader: Reader, target: Path) -> Iterator[Writer]:
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
        mcap = any(".mcap" in file.suffixes for file in _files(source))
        plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
        writer = Writer2(target, version=8, storage_plugin=plugin)
        if reader.compression_mode:
            mode = CompressionMode[reader.compression_mode.upper()]
            writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        yield writer


def _added(writer: Writer, one: Connection) -> Connection:
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
