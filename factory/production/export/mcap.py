"""Datasets as recordings of a sonar for ROS 2: one MCAP file a split, by the library rosbags."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from ...common.array_types import Array, Float32s, Float64s
from ...common.errors import FactoryError
from ...common.ros_types import SONAR, typestore
from ...common.settings import build
from ...dataset.fan_geometry import FanGeometry, SonarDevice, drawn_sonar, recorded_sonar
from ...dataset.meaning import formation_of
from ...dataset.pair_dataset import PairDataset
from ...simulation.sonar.array import WaterSettings
from .notes import write_notes
from .samples import ExportedSample, read_samples

_POSE = "geometry_msgs/msg/PoseStamped"
_IMAGE = "sensor_msgs/msg/Image"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_STATIC = "/tf_static"
_LAYERS = ("noisy", "clean")
_WORLD = "world"
_SONAR_FRAME = "sonar"
"""Frame of the device by REP 103: x ahead, y left, z up."""
_PING_FRAME = "sonar_ping"
"""Frame of ProjectedSonarImage by its definition: z ahead, x up, so y right."""
_FROM_PING = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
"""Quaternion (x, y, z, w) that turns axes of the sonar's frame into those of the ping's: half a
turn about the diagonal of x and z."""
# Period of frames whose recording states no time.
_PERIOD_S = 0.1
_PAUSE_S = 10.0
"""Between two scenes of a file."""
# Bags of time 0 count as undated in some programs: 2000-01-01.
_BEGIN_S = 946_684_800.0
_LEAST_CLOCK_S = 1e8
"""Times of recordings from which on they are seconds since 1970."""
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


def write_mcap(pairs: PairDataset, folder: Path) -> str:
    """SPLIT/SPLIT.mcap and its metadata.yaml, which `ros2 bag play SPLIT` takes.

    Topics: /sonar/noisy and /sonar/clean (ProjectedSonarImage: one row per range, one column per
    beam; a fan is sampled at the device's ranges and beams), /sonar/noisy/image and
    /sonar/clean/image (Image, as stored), /tf_static (where the axes of pings lie in the sonar),
    and /sonar/pose (PoseStamped) and /tf where the dataset has `dataset.columns=[pose]` and its
    recordings have poses.
    Raises FactoryError for a dataset whose device is not known.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer

    sonar = recorded_sonar(pairs.form.config)
    devices = pairs.form.config.get("devices") or {}
    if sonar is None or devices.get("field_share") is not None:
        raise FactoryError(
            f"{pairs.folder}: some of its images are points seen from above, which have no ranges "
            "and beams; export with --to png"
        )
    config = pairs.form.config
    store = typestore(2)
    count = 0
    for split in pairs.splits:
        writer = Writer(folder / split, version=9, storage_plugin=StoragePlugin.MCAP)
        with writer:
            connections: dict[str, Any] = {}
            for sample, time_s in _timed(read_samples(pairs, split)):
                count += 1
                for topic, kind, message in _messages(sample, time_s, sonar, config, store.types):
                    if topic in connections and topic == _STATIC:
                        continue
                    if topic not in connections:
                        connections[topic] = writer.add_connection(
                            topic, kind, typestore=store, offered_qos_profiles=_profiles(topic)
                        )
                    content = store.serialize_cdr(message, kind)
                    writer.write(connections[topic], round(time_s * 1e9), content)
    write_notes(pairs, folder, _NOTES, layers=_LAYERS, has_records=False)
    return f"{len(pairs.splits)} MCAP files, {count} pings"


def _timed(split_samples: Iterator[ExportedSample]) -> Iterator[tuple[ExportedSample, float]]:
    """Each sample with its time, in seconds since 1970.

    Scenes lie one after another: at the times of their recordings, where these have a clock and do
    not overlap, else behind a pause.  Inside a scene the times are its own.
    """
    scene: tuple[object, ...] | None = None
    begin_s = last_s = _BEGIN_S - _PAUSE_S
    first_s = 0.0
    for sample in split_samples:
        record = sample.record
        own_s = float(record.get("time_s", math.nan))
        key = (record["location"], record["scene"], record["variant"])
        if key[:2] != (scene or ())[:2]:
            begin_s = last_s + _PAUSE_S
            if own_s > max(_LEAST_CLOCK_S, last_s):
                begin_s = own_s
            first_s = own_s
            scene = key
            last_s = begin_s
            yield sample, begin_s
            continue
        later_s = begin_s + own_s - first_s
        last_s = later_s if later_s > last_s else last_s + _PERIOD_S
        yield sample, last_s


def _messages(
    sample: ExportedSample,
    time_s: float,
    sonar: SonarDevice,
    config: Mapping[str, Any],
    types: Mapping[str, Any],
) -> Iterator[tuple[str, str, Any]]:
    """Topic, type and content of each message of a sample."""
    seconds = int(time_s)
    stamp = types["builtin_interfaces/msg/Time"](
        sec=seconds, nanosec=min(round((time_s - seconds) * 1e9), 999_999_999)
    )
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=_PING_FRAME)
    yield _STATIC, _TRANSFORMS, _ping_axes(stamp, types)
    sonar = drawn_sonar(sonar, sample.record)
    facts = ping_facts(config, sonar)
    geometry = FanGeometry.from_record(sonar, sample.record)
    grid = polar_grid(sonar, geometry)
    for layer in _LAYERS:
        image = sample.images[layer]
        polar = polar_image(image, geometry, grid)
        yield f"/sonar/{layer}", SONAR, _ping(polar, grid, header, sonar, facts, types)
        yield f"/sonar/{layer}/image", _IMAGE, _image(image, header, types)
    pose = _pose(sample.record, stamp, types)
    if pose is not None:
        yield "/sonar/pose", _POSE, pose
        yield "/tf", _TRANSFORMS, _transform(pose.pose, stamp, types)


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

    if topic != _STATIC:
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


def _ping_axes(stamp: Any, types: Mapping[str, Any]) -> Any:
    """Where the axes of pings lie in the sonar."""
    x, y, z, w = _FROM_PING
    rotation = types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)
    transform = types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0), rotation=rotation
    )
    return _stamped(transform, _SONAR_FRAME, _PING_FRAME, stamp, types)


def _transform(pose: Any, stamp: Any, types: Mapping[str, Any]) -> Any:
    """A pose of the sonar in the world, as a transform."""
    position = pose.position
    transform = types["geometry_msgs/msg/Transform"](
        translation=types["geometry_msgs/msg/Vector3"](x=position.x, y=position.y, z=position.z),
        rotation=pose.orientation,
    )
    return _stamped(transform, _WORLD, _SONAR_FRAME, stamp, types)


def _stamped(transform: Any, parent: str, child: str, stamp: Any, types: Mapping[str, Any]) -> Any:
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=parent)
    stamped = types["geometry_msgs/msg/TransformStamped"](
        header=header, child_frame_id=child, transform=transform
    )
    return types[_TRANSFORMS](transforms=[stamped])


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


def _ping(
    polar: Array, grid: PingGrid, header: Any, sonar: SonarDevice,
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
        frequency=1000 * sonar.frequency_khz,
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


def _image(image: Array, header: Any, types: Mapping[str, Any]) -> Any:
    height, width = image.shape
    return types[_IMAGE](
        header=header,
        height=height,
        width=width,
        encoding=_ENCODINGS[str(image.dtype)],
        is_bigendian=0,
        step=width * image.dtype.itemsize,
        data=np.ascontiguousarray(image).reshape(-1).view(np.uint8),
    )


def _pose(record: Mapping[str, Any], stamp: Any, types: Mapping[str, Any]) -> Any | None:
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
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=_WORLD)
    return types[_POSE](header=header, pose=pose)


_NOTES = """\
`SPLIT/SPLIT.mcap` opens in Foxglove; `ros2 bag play SPLIT` plays it.

| topic | message | frame |
|---|---|---|
| /sonar/noisy, /sonar/clean | marine_acoustic_msgs/ProjectedSonarImage | `sonar_ping` |
| /sonar/noisy/image, /sonar/clean/image | sensor_msgs/Image, as stored | `sonar_ping` |
| /sonar/pose | geometry_msgs/PoseStamped: the sonar in the world, where it is known | `world` |
| /tf | `world` to `sonar`, the same poses | |
| /tf_static | `sonar` to `sonar_ping` | |

Pings have a row a range and a column a beam, from left to right.

`world` and `sonar` follow REP 103 (of the sonar: x ahead, y left, z up). `sonar_ping` has the axes
of ProjectedSonarImage: z ahead, x up, y right; beam_directions are (0, sin, cos) of the bearing,
which is positive to the right.

ping_info: sound_speed in m/s is that of the simulated water; tx_beamwidths has the width in
elevation, rx_beamwidths that of each beam in azimuth, both -3 dB and in radians. In pointwise
images a beam is as wide as the beams lie apart.

Times are seconds since 1970. Recordings with a clock keep their times, unless they overlap with the
scene before in the file; others follow with a pause of 10 s, from 2000-01-01 on. Frames without
times are .1 s apart.

```python
from simnfnd import open_recording

for frame in open_recording("train/train.mcap"):  # /sonar/clean and /sonar/noisy in turn
    print(frame.time_s, frame.image.shape, frame.geometry.range_max_m)
```
"""
