"""Bags of ROS 1 (.bag) and ROS 2 (a folder, or one .mcap or .db3) by the library rosbags.

Frames are the messages of some topics; `rewrite` makes the same bag, uncompressed, with other
samples in them.  Types are those that the standard packages and marine_acoustic_msgs define; what a
bag says of its types is compared with them and never run.  Compressed bags unpack as the library
does, without a bound.  Single messages may be those of rosbags or of rclpy, whose fields have the
same names.
"""

from __future__ import annotations

import os
from array import array
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from copy import deepcopy
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError, FrameError
from ...factory.common.extras import Need, require
from ...factory.common.files import temporary_folder
from ...factory.common.ros_types import SONAR, typestore
from .base import (
    MOST_BEAMS,
    MOST_PIXELS,
    MOST_RANGE_M,
    MOST_RANGES,
    Beams,
    Ended,
    Recording,
    RecordingDevice,
    SonarFrame,
    explained,
    known,
)
from .images import decoded

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"

# SonarImageData.DTYPE_* that a frame can hold.
_SONAR_DTYPES = {0: "u1", 2: "u2", 8: "f4"}
# Encoding of an Image -> type and number of its channels, which stay in their order.
_ENCODINGS = {
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1)),
    **dict.fromkeys(("32FC1",), ("f4", 1)),
    **dict.fromkeys(("rgb8", "bgr8", "8UC3"), ("u1", 3)),
    **dict.fromkeys(("rgba8", "bgra8", "8UC4"), ("u1", 4)),
    **dict.fromkeys(("rgb16", "bgr16", "16UC3"), ("u2", 3)),
}
_DAMAGED = "cannot be read, it is damaged or no bag"
_REPAIRS = {
    ".bag": "; if it is cut short, `rosbag reindex` repairs the file",
    ".mcap": "; if it is cut short, `mcap recover` repairs the file",
    ".db3": "; if it is cut short, `sqlite3 OLD .recover | sqlite3 NEW` repairs the file",
}
"""Suffix of a bag that is one file -> the tool that repairs it."""
_UNKNOWN_DIGEST = "RIHS01_" + 64 * "0"  # of a type of which only the name is known


class RosBag(Recording):
    """A bag; a `Recording`.

    topics: whose messages are the frames.  Without, those of all sonars
    (marine_acoustic_msgs/ProjectedSonarImage), or else the only one with images
    (sensor_msgs/Image or CompressedImage).
    Frames are read in order; one by number is searched from where reading stands.
    """

    def __init__(self, path: Path, topics: Sequence[str] = ()) -> None:
        """Raises FactoryError when the bag cannot be read or has no such topics."""
        self._requested = topics
        super().__init__(path)

    def _open(self) -> None:
        require([Need(f"{self.path}", "rosbags")])
        self.version = 1 if self.path.suffix.lower() == ".bag" and self.path.is_file() else 2
        self._library: Any = import_module(f"rosbags.rosbag{self.version}")
        with closing(self._reader()) as reader:
            self._connections = list(reader.connections)
        chosen = self._chosen_connections()
        self._chosen = {connection.id for connection in chosen}
        self.topics = tuple(dict.fromkeys(connection.topic for connection in chosen))
        self._files = list(self.path.iterdir()) if self.path.is_dir() else [self.path]
        # A message takes a byte at least, whatever the bag says.
        stated = sum(int(connection.msgcount) for connection in chosen)
        self.count = min(stated, sum(file.stat().st_size for file in self._files))
        if self.count < 1:
            raise FactoryError(f"{self.path}: holds no message on {', '.join(self.topics)}")
        self._next = 0
        self._frames = self._messages(chosen)

    def _chosen_connections(self) -> list[Connection]:
        """The connections whose messages are the frames."""
        fit = [connection for connection in self._connections if connection.msgtype in _PIXELS]
        names = ", ".join(dict.fromkeys(connection.topic[:80] for connection in fit)) or "none"
        absent = [
            topic
            for topic in self._requested
            if topic not in {connection.topic for connection in fit}
        ]
        if absent:
            raise FactoryError(f"{self.path}: no images on the topic {absent[0]}; it has {names}")
        sonars = [connection for connection in fit if connection.msgtype == SONAR]
        chosen = (
            [connection for connection in fit if connection.topic in self._requested]
            or sonars
            or fit
        )
        if not chosen:
            kinds = "ProjectedSonarImage, Image or CompressedImage"
            raise FactoryError(f"{self.path}: holds no topic with images ({kinds})")
        if chosen is fit and len({connection.topic for connection in fit}) > 1:
            said = f"has images on several topics ({names}); say with --topic"
            raise FactoryError(f"{self.path}: {said} which of them are of a sonar")
        for connection in chosen:
            if connection.digest not in (
                "",
                "*",
                None,
                digest_of(connection.msgtype, self.version),
            ):
                mismatch = f"another {connection.msgtype} than this program knows"
                stated = f"its fingerprint is {connection.digest[:80]}"
                raise FactoryError(f"{self.path}: {connection.topic} has {mismatch} ({stated})")
        return chosen

    def _read(self, number: int) -> SonarFrame:
        if number < self._next:
            chosen = [
                connection for connection in self._connections if connection.id in self._chosen
            ]
            self._next = 0
            self._frames = self._messages(chosen)
        for place, (connection, time_ns, _, message) in enumerate(self._frames, start=self._next):
            self._next = place + 1
            if place == number:
                name = self._named(number)
                frame = frame_of(message, connection.msgtype, number, time_ns * 1e-9, name)
                is_one = len(self.topics) == 1
                return frame if is_one else replace(frame, sequence=connection.topic)
        self._next = self.count
        raise Ended(f"{self.path}: ends before frame {number}; it is cut short or damaged")

    def rewrite(self, samples: Iterable[Array], path: Path) -> None:
        """Write the bag with other samples in its frames; everything else is copied.

        samples: of each frame in order, in the shape and type of `SonarFrame.samples`.
        Raises ValueError for samples of another shape, type or number, FrameError when the bag is
        damaged, FactoryError when `path` is there or cannot be written.
        """
        with temporary_folder(path) as folder:
            # The library names the file of a ROS 2 bag as its folder.
            target = folder / (path.stem if self.path.is_file() else path.name)
            if self.version == 1:
                target = target.with_suffix(".bag")
            self._write(iter(samples), target)
            if self.version == 2 and self.path.is_file():
                (target,) = (file for file in target.iterdir() if file.suffix in (".mcap", ".db3"))
            os.replace(target, path)

    def _write(self, samples: Iterator[Array], target: Path) -> None:
        store = typestore(self.version)
        damaged = f"{self.path}: cannot be copied"
        serialized = store.serialize_ros1 if self.version == 1 else store.serialize_cdr
        kind = "md5sum" if self.version == 1 else "rihs01"
        number = 0
        with self._writer(target) as writer:
            added = {}
            for connection in self._connections:
                is_known = connection.msgtype in store.fielddefs
                digest = (
                    digest_of(connection.msgtype, self.version) if is_known else _UNKNOWN_DIGEST
                )
                about = {kind: connection.digest or digest, **connection.ext._asdict()}
                with explained(damaged, passing=OSError, reason=True):
                    added[connection.id] = writer.add_connection(
                        connection.topic, connection.msgtype, msgdef=connection.msgdef.data, **about
                    )
            for connection, time_ns, data, message in self._messages(self._connections):
                content: bytes | memoryview = data
                if message is not None:
                    new = next(samples, None)
                    if new is None:
                        raise ValueError(f"{self.path}: has more frames than samples were given")
                    changed = with_samples(message, connection.msgtype, new, self._named(number))
                    content = serialized(changed, connection.msgtype)
                    number += 1
                with explained(damaged, passing=OSError, reason=True):
                    writer.write(added[connection.id], time_ns, content)
        if next(samples, None) is not None:
            raise ValueError(f"{self.path}: has fewer frames than samples were given")

    def _writer(self, target: Path) -> Any:
        """A writer of the same kind of bag, without compression."""
        if self.version == 1:
            return self._library.Writer(target)
        mcap = any(".mcap" in file.suffixes for file in self._files)
        plugins = self._library.StoragePlugin
        plugin = plugins.MCAP if mcap else plugins.SQLITE3
        return self._library.Writer(target, version=8, storage_plugin=plugin)

    def _reader(self) -> Any:
        """The bag, opened once more, as two that read in turns would lose their places."""
        try:
            with explained(f"{self.path}: {_DAMAGED}", reason=True):
                reader = self._library.Reader(self.path)
                reader.open()
                return reader
        except FrameError as error:
            hint = _REPAIRS.get(self.path.suffix.lower(), "")
            raise FrameError(f"{error}{hint}") from error

    def _messages(
        self, connections: Sequence[Connection]
    ) -> Generator[tuple[Connection, int, bytes, Any]]:
        """(connection, nanoseconds since 1970, content, the message of a frame) of all, in order.

        Raises FrameError at damage.
        """
        store = typestore(self.version)
        number = 0
        read = store.deserialize_ros1 if self.version == 1 else store.deserialize_cdr
        with closing(self._reader()) as reader, closing(reader.messages(connections)) as messages:
            while True:
                with explained(f"{self.path}: {_DAMAGED}", reason=True):
                    stored = next(messages, None)
                if stored is None:
                    return
                connection, _, data = stored
                message = None
                if connection.id in self._chosen:
                    name = f"{self._named(number)}: cannot be read, it is damaged"
                    with explained(name, reason=True):
                        message = read(data, connection.msgtype)
                    number += 1
                yield *stored, message

    def _named(self, number: int) -> str:
        return f"{self.path}: message {number} of {', '.join(self.topics)}"


def digest_of(msgtype: str, version: int) -> str:
    """What a bag must state as the fingerprint of a type: an MD5 in ROS 1, RIHS01 in ROS 2."""
    store = typestore(version)
    return store.generate_msgdef(msgtype)[1] if version == 1 else store.hash_rihs01(msgtype)


def frame_of(message: Any, msgtype: str, number: int, bag_time_s: float, name: str) -> SonarFrame:
    """The frame in a message.

    bag_time_s: when it was recorded, taken where its header has no stamp.  name: names the message
    in errors.  Raises FrameError when its parts contradict each other or cannot be read.
    """
    stamp = message.header.stamp
    time_s = stamp.sec + stamp.nanosec * 1e-9 or bag_time_s
    frame_id = message.header.frame_id or "unknown"
    samples = _PIXELS[msgtype](message, name)
    # In the byte order of this machine, and contiguous.
    samples = np.ascontiguousarray(samples, samples.dtype.newbyteorder("="))
    if msgtype != SONAR:
        return SonarFrame(number, samples, time_s=time_s, device=RecordingDevice(frame_id))
    frequency_khz = known(message.ping_info.frequency / 1000) or None
    speed_m_s = known(message.ping_info.sound_speed, 1e4) or None
    device = RecordingDevice(frame_id, frequency_khz=frequency_khz, sound_speed_m_s=speed_m_s)
    return SonarFrame(number, samples, _beams(message, name), time_s, device=device)


def with_samples(message: Any, msgtype: str, samples: Array, name: str) -> Any:
    """The message with other samples, of the shape and type of those of its frame.

    A compressed image is compressed as it was, JPEG at its best quality.
    Raises ValueError for samples of another shape or type.
    """
    before = _PIXELS[msgtype](message, name)
    if samples.shape != before.shape or samples.dtype != before.dtype.newbyteorder("="):
        raise ValueError(
            f"samples are {samples.dtype} {samples.shape}; expected {before.dtype} {before.shape}"
        )
    if np.array_equal(samples, before):  # JPEG would change them
        return message
    # A copy of all bytes, so that what lies between the rows stays.
    changed = deepcopy(message)
    if msgtype != COMPRESSED:
        _PIXELS[msgtype](changed, name)[...] = samples
        return changed
    jpeg = bytes(message.data[:2]) == b"\xff\xd8"
    options = [cv2.IMWRITE_JPEG_QUALITY, 100] if jpeg else []
    done, content = cv2.imencode(".jpg" if jpeg else ".png", samples, options)
    assert done
    # rclpy holds bytes in an `array`, rosbags in NumPy.
    rclpy = isinstance(message.data, array)
    changed.data = array("B", content.tobytes()) if rclpy else np.asarray(content).ravel()
    return changed


def _image(message: Any, name: str) -> Array:
    """The pixels of an Image, (H, W) or (H, W, channels), in its own memory."""
    height = int(message.height)
    width = int(message.width)
    step = int(message.step)
    if message.encoding not in _ENCODINGS:
        raise FrameError(
            f"{name} has the encoding {str(message.encoding)[:40]!r}, which cannot be denoised "
            f"({', '.join(_ENCODINGS)})"
        )
    kind, channels = _ENCODINGS[message.encoding]
    dtype = np.dtype((">" if message.is_bigendian else "<") + kind)
    held = len(message.data)
    row = width * channels * dtype.itemsize
    if not 0 < height * width <= MOST_PIXELS or row > step or height * step != held:
        raise FrameError(
            f"{name} says {width} x {height} pixels in rows of {step} bytes, and holds {held} "
            "bytes; it is damaged"
        )
    strides = (step, channels * dtype.itemsize, dtype.itemsize)
    pixels: Array = np.ndarray((height, width, channels), dtype, message.data, strides=strides)
    return pixels[..., 0] if channels == 1 else pixels


def _samples(message: Any, name: str) -> Array:
    """(ranges, beams) of a ProjectedSonarImage, in its own memory."""
    image = message.image
    ranges = len(message.ranges)
    beams = int(message.image.beam_count)
    if image.dtype not in _SONAR_DTYPES:
        raise FrameError(
            f"{name} has samples of type {image.dtype}; uint8 (0), uint16 (2) and float32 (8) can "
            "be read"
        )
    dtype = np.dtype((">" if image.is_bigendian else "<") + _SONAR_DTYPES[image.dtype])
    fits = 2 <= ranges <= MOST_RANGES and 2 <= beams <= MOST_BEAMS
    directions = len(message.beam_directions)
    held = len(image.data)
    if not fits or beams != directions or ranges * beams * dtype.itemsize != held:
        raise FrameError(
            f"{name} says {ranges} ranges, {beams} beams and {directions} directions, and holds "
            f"{held} bytes; it is damaged"
        )
    samples: Array = np.ndarray((ranges, beams), dtype, image.data)
    return samples


_PIXELS: dict[str, Callable[[Any, str], Array]] = {
    SONAR: _samples,
    IMAGE: _image,
    COMPRESSED: lambda message, name: decoded(bytes(message.data), name),
}
"""What a frame shows, by the type of its message."""


def _beams(message: Any, name: str) -> Beams:
    """Where the samples lie.

    The message has z ahead, x up and y to the side.  Drivers do not agree on the sign of y, but
    store beams from left to right, so bearings are taken to ascend; some simulators have x ahead.
    """
    x, y, z = (
        np.array([getattr(direction, axis) for direction in message.beam_directions], np.float64)
        for axis in "xyz"
    )
    bearings = np.arctan2(y, x if np.abs(z).max() < 1e-6 else z)
    if bearings[0] > bearings[-1]:
        bearings = -bearings
    ranges = np.asarray(message.ranges, np.float64)
    ahead = np.abs(bearings).max() <= np.pi / 2
    if not (ahead and np.isfinite(bearings).all() and np.all(np.diff(bearings) > 0)):
        raise FrameError(f"{name} has beams in disorder, or that look back; it cannot be used")
    step = (ranges[-1] - ranges[0]) / (len(ranges) - 1)
    even = np.abs(ranges - np.linspace(ranges[0], ranges[-1], len(ranges))).max() < step
    if not (even and ranges[-1] + step / 2 <= MOST_RANGE_M and ranges[0] + step / 2 > 0):
        raise FrameError(f"{name} has ranges that do not ascend evenly from 0 m on")
    near = max(0.0, float(ranges[0] - step / 2))
    return Beams(tuple(bearings.tolist()), near, float(ranges[-1] + step / 2))
