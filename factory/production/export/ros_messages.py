"""Messages of ROS 2 for pings, and the MCAP files that hold them (extra `ros`).

types: classes of messages by their names, those of a typestore of rosbags or of a running ROS.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

import numpy as np

from ...common.array_types import Array, Float32s, Float64s
from ...common.errors import FactoryError
from ...common.ros_types import SONAR, typestore
from ...common.settings import build
from ...dataset.fan_geometry import FanGeometry, SonarDevice
from ...dataset.meaning import formation_of
from ...simulation.sonar.array import WaterSettings

POSE = "geometry_msgs/msg/PoseStamped"
IMAGE = "sensor_msgs/msg/Image"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
STATIC = "/tf_static"
WORLD = "world"
SONAR_FRAME = "sonar"
"""Frame of the device by REP 103: x ahead, y left, z up."""
PING_FRAME = "sonar_ping"
"""Frame of ProjectedSonarImage by its definition: z ahead, x up, so y right."""
_FROM_PING = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Quaternion (x, y, z, w) that turns axes of the sonar's frame into those of the ping's: half a
turn about the diagonal of x and z."""
POINTS = "sensor_msgs/msg/PointCloud2"
_DTYPES = {"uint8": 0, "float32": 8}
_ENCODINGS = {"uint8": "mono8", "float32": "32FC1"}


class PingFacts(NamedTuple):
    """What a device says of all its pings.

    sound_speed_m_s: of the water.  vertical_rad, beam_rad: -3 dB widths of the transmitted beam in
    elevation, and of a received one in azimuth.
    """

    sound_speed_m_s: float
    vertical_rad: float
    beam_rad: float


class PingGrid(NamedTuple):
    """The ranges (R,) in metres and bearings (B,) in radians, right positive, of a polar image."""

    ranges_m: Float64s
    bearings_rad: Float64s


class Bag:
    """An MCAP file and its metadata.yaml in a new folder, which `ros2 bag play` takes."""

    def __init__(self, folder: Path) -> None:
        from rosbags.rosbag2 import StoragePlugin, Writer

        self._store = typestore(2)
        self.types: Mapping[str, Any] = self._store.types
        self._writer = Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP)
        self._connections: dict[str, Any] = {}

    def __enter__(self) -> Bag:
        self._writer.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._writer.close()

    def write(self, time_s: float, messages: Iterable[tuple[str, str, Any]]) -> None:
        """Write topic, type and content of messages; static ones once."""
        for topic, kind, message in messages:
            connection = self._connections.get(topic)
            if connection is not None and topic == STATIC:
                continue
            if connection is None:
                connection = self._writer.add_connection(
                    topic, kind, typestore=self._store, offered_qos_profiles=_profiles(topic)
                )
                self._connections[topic] = connection
            content = self._store.serialize_cdr(message, kind)
            self._writer.write(connection, round(time_s * 1e9), content)


def stamp_at(time_s: float, types: Mapping[str, Any]) -> Any:
    """A time in seconds since 1970."""
    seconds = int(time_s)
    nanoseconds = min(round((time_s - seconds) * 1e9), 999_999_999)
    return types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)


def cloud_message(points: Array, header: Any, types: Mapping[str, Any]) -> Any:
    """The message PointCloud2 of (N,) points with named fields."""
    numbers = {"<f4": 7, "|u1": 2, "<u2": 4}  # PointField's codes
    assert points.dtype.fields is not None
    fields = [
        types["sensor_msgs/msg/PointField"](
            name=name, offset=int(offset), datatype=numbers[kind.str], count=1
        )
        for name, (kind, offset, *_) in points.dtype.fields.items()
    ]
    return types[POINTS](
        header=header,
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=points.dtype.itemsize,
        row_step=points.dtype.itemsize * len(points),
        data=np.frombuffer(points.tobytes(), np.uint8),
        is_dense=True,
    )


def ping_facts(config: Mapping[str, Any], sonar: SonarDevice) -> PingFacts:
    """What the configuration of a dataset says of the pings of a device; 0: it does not say it.

    In pointwise images an echo lies in one beam, which is so as wide as the beams lie apart.  Of
    devices that are drawn for each image, widths are not kept.
    """
    keys = config["sonar"]
    speed_m_s = 0.0
    with suppress(FactoryError, TypeError):
        water: WaterSettings = build(WaterSettings, dict(config.get("water") or {}))
        speed_m_s = water.sound_speed_m_s()
    vertical_deg = beam_deg = 0.0
    if config.get("devices") is None:
        vertical_deg = float(keys.get("vfov_deg", 0.0))
        beam_deg = sonar.hfov_deg / sonar.beams
    if formation_of(config) == "coherent":
        beam_deg = float((keys.get("array") or {}).get("beamwidth_deg", 0.0))
    return PingFacts(speed_m_s, math.radians(vertical_deg), math.radians(beam_deg))


def ping_axes(stamp: Any, types: Mapping[str, Any]) -> Any:
    """Where the axes of pings lie in the sonar."""
    x, y, z, w = _FROM_PING
    rotation = types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
    transform = types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0), rotation=rotation
    )
    return _stamped(transform, SONAR_FRAME, PING_FRAME, stamp, types)


def transform(pose: Any, stamp: Any, types: Mapping[str, Any]) -> Any:
    """A pose of the sonar in the world, as a transform."""
    position = pose.position
    transform = types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](x=position.x, y=position.y, z=position.z),
        rotation=pose.orientation,
    )
    return _stamped(transform, WORLD, SONAR_FRAME, stamp, types)


def _stamped(transform: Any, parent: str, child: str, stamp: Any, types: Mapping[str, Any]) -> Any:
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=parent)
    stamped = types["geometry_msgs/msg/TransformStamped"](
        header=header, child_frame_id=child, transform=transform
    )
    return types[TRANSFORMS](transforms=[stamped])


def polar_grid(sonar: SonarDevice, geometry: FanGeometry) -> PingGrid:
    """The ranges and bearings that the device measures in the window of an image."""
    near = geometry.range_min_m
    far = geometry.range_max_m
    assert near is not None
    assert far is not None
    steps = (np.arange(sonar.range_bins) + 0.5) / sonar.range_bins
    return PingGrid(near + steps * (far - near), sonar.beam_centres_rad().astype(np.float64))


def polar_image(image: Array, geometry: FanGeometry, grid: PingGrid) -> Array:
    """(R, B) of the same type: a polar image as it is, a fan at the nearest pixels to the grid."""
    import cv2  # of the extra `ros`, which tables do without

    if geometry.layout == "polar":
        return image
    assert geometry.range_max_m is not None
    fraction = grid.ranges_m[:, None] / geometry.range_max_m
    rows, columns = geometry.pixels(fraction, grid.bearings_rad[None])
    shape = (len(grid.ranges_m), len(grid.bearings_rad))
    across, down = (
        np.ascontiguousarray(np.broadcast_to(place, shape), np.float32) for place in (columns, rows)
    )
    return np.asarray(cv2.remap(image, across, down, cv2.INTER_NEAREST))


def ping_message(
    polar: Array, grid: PingGrid, header: Any, frequency_hz: float,
    facts: PingFacts, types: Mapping[str, Any],
) -> Any:  # fmt: skip
    """The message ProjectedSonarImage of a ping: samples, beams, ranges and what is known of it."""
    direction = types["geometry_msgs/msg/Vector3"]
    samples = types["marine_acoustic_msgs/msg/SonarImageData"](
        is_bigendian=False,
        dtype=_DTYPES[str(polar.dtype)],
        beam_count=polar.shape[1],
        data=np.ascontiguousarray(polar).reshape(-1).view(np.uint8),
    )
    info = types["marine_acoustic_msgs/msg/PingInfo"](
        frequency=frequency_hz,
        sound_speed=facts.sound_speed_m_s,
        tx_beamwidths=_widths(facts.vertical_rad, 1),
        rx_beamwidths=_widths(facts.beam_rad, polar.shape[1]),
    )
    return types[SONAR](
        header=header,
        ping_info=info,
        beam_directions=[
            direction(x=0.0, y=math.sin(bearing), z=math.cos(bearing))
            for bearing in grid.bearings_rad.tolist()
        ],
        ranges=grid.ranges_m.astype(np.float32),
        image=samples,
    )


def _widths(width_rad: float, count: int) -> Float32s:
    """(count,) of a width; empty where it is unknown, as the message has it."""
    return np.full(count if width_rad > 0 else 0, width_rad, np.float32)


def image_message(image: Array, header: Any, types: Mapping[str, Any]) -> Any:
    """The message Image of an (H, W) image."""
    height, width = image.shape
    return types[IMAGE](
        header=header,
        height=height,
        width=width,
        encoding=_ENCODINGS[str(image.dtype)],
        is_bigendian=0,
        step=width * image.dtype.itemsize,
        data=np.ascontiguousarray(image).reshape(-1).view(np.uint8),
    )


def pose_message(record: Mapping[str, Any], stamp: Any, types: Mapping[str, Any]) -> Any | None:
    """The sonar in the world; None where the dataset does not say."""
    numbers = {
        name: float(record.get(f"sonar.{name}", math.nan))
        for name in ("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
    }
    if not all(map(math.isfinite, numbers.values())):
        return None
    position = types["geometry_msgs/msg/Point"](
        x=numbers["x_m"], y=numbers["y_m"], z=numbers["z_m"]
    )
    orientation = types["geometry_msgs/msg/Quaternion"](
        x=numbers["qx"], y=numbers["qy"], z=numbers["qz"], w=numbers["qw"]
    )
    pose = types["geometry_msgs/msg/Pose"](position=position, orientation=orientation)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=WORLD)
    return types[POSE](header=header, pose=pose)


def _profiles(topic: str) -> tuple[Any, ...]:
    """The quality of service of a topic: a static one is kept for subscribers that come later."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    if topic != STATIC:
        return ()
    for_ever = QosTime(9223372036, 854775807)  # seconds and nanoseconds of ROS's infinite duration
    profile = Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=for_ever,
        lifespan=for_ever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=for_ever,
        avoid_ros_namespace_conventions=False,
    )
    return (profile,)
