"""Small bags of ROS 1 and 2, written by the tests."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from simnfnd.factory.common.ros_types import SONAR, typestore
from simnfnd.models.recordings.rosbag import COMPRESSED, IMAGE

START_NS = 1_700_000_000_000_000_000
STEP_NS = 100_000_000
STRING = "std_msgs/msg/String"


def header(store: Any, number: int) -> Any:
    kinds = store.types
    header_fields = (
        {} if "seq" not in kinds["std_msgs/msg/Header"].__annotations__ else {"seq": number}
    )
    time = kinds["builtin_interfaces/msg/Time"](sec=1_600_000_000 + number, nanosec=250_000_000)
    return kinds["std_msgs/msg/Header"](stamp=time, frame_id="sonar", **header_fields)


def sonar(store: Any, number: int, samples: np.ndarray, *, side: int = 1, big: bool = False) -> Any:
    """Bearings from -30 to 30 degrees, ranges from 1 to 5 m; side: the sign of y to the right."""
    kinds = store.types
    ranges, beams = samples.shape
    bearings = np.deg2rad(np.linspace(-30, 30, beams))
    vector = kinds["geometry_msgs/msg/Vector3"]
    data = samples.astype(samples.dtype.newbyteorder(">" if big else "<")).tobytes()
    return kinds[SONAR](
        header=header(store, number),
        ping_info=kinds["marine_acoustic_msgs/msg/PingInfo"](
            1.2e6, 1490.0, np.zeros(beams, np.float32), np.zeros(0, np.float32)
        ),
        beam_directions=[vector(0.0, side * np.sin(b), np.cos(b)) for b in bearings],
        ranges=(1 + (np.arange(ranges) + 0.5) * 4 / ranges).astype(np.float32),
        image=kinds["marine_acoustic_msgs/msg/SonarImageData"](
            is_bigendian=big,
            dtype={"uint8": 0, "uint16": 2, "float32": 8}[str(samples.dtype)],
            beam_count=beams,
            data=np.frombuffer(data, np.uint8),
        ),
    )


def image(
    store: Any, number: int, image: np.ndarray, encoding: str = "mono8", padding: int = 0
) -> Any:
    rows = image.reshape(len(image), -1).view(np.uint8)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=77)
    return store.types[IMAGE](
        header(store, number), *image.shape[:2], encoding, 0, rows.shape[1], rows.ravel()
    )


def compressed(store: Any, number: int, image: np.ndarray, suffix: str = ".png") -> Any:
    content = cv2.imencode(suffix, image)[1]
    return store.types[COMPRESSED](header(store, number), suffix[1:], np.asarray(content).ravel())


def write_bag(
    path: Path,
    topics: dict[str, tuple[str, list[Any]]],
    *,
    compression: str = "",
    storage: str = "sqlite3",
) -> Path:
    """Topics with their type and messages, in turns, and a topic /notes of texts among them.

    A .bag is of ROS 1, a .mcap or .db3 the file of a bag of ROS 2, another name its folder.
    compression: bz2 or lz4 (ROS 1), file or message (ROS 2).
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2

    writer: Any
    single = path.suffix in (".mcap", ".db3")
    if path.suffix == ".bag":
        version = 1
        writer = Writer1(path)
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
    else:
        plugin = StoragePlugin.MCAP if "mcap" in (storage, path.suffix[1:]) else 1
        folder = path.with_suffix(".folder") / path.stem if single else path
        version = 2
        writer = Writer2(folder, version=8, storage_plugin=StoragePlugin(plugin))
        if compression:
            mode = CompressionMode[compression.upper()]
            writer.set_compression(mode, CompressionFormat.ZSTD)
    store = typestore(version)
    serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with writer:
        notes = writer.add_connection("/notes", STRING, typestore=store)
        added = {
            topic: writer.add_connection(topic, kind, typestore=store)
            for topic, (kind, _) in topics.items()
        }
        for number in range(max(len(actual) for _, actual in topics.values())):
            time_ns = START_NS + number * STEP_NS
            text = store.types[STRING](f"note {number}")
            writer.write(notes, time_ns, serialize(text, STRING))
            for shift, (topic, (kind, actual)) in enumerate(topics.items(), start=1):
                if number < len(actual):
                    message = serialize(actual[number], kind)
                    writer.write(added[topic], time_ns + shift, message)
    if single:
        (folder / path.name).rename(path)
    return path


def content(path: Path) -> Iterator[tuple[str, str, int, Any]]:
    """(topic, type, time of recording, message) by the library alone."""
    from rosbags.highlevel import AnyReader

    with AnyReader([path]) as reader:
        for connection, time_ns, data in reader.messages():
            yield (
                connection.topic,
                connection.msgtype,
                time_ns,
                reader.deserialize(data, connection.msgtype),
            )
