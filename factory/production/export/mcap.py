"""Datasets as recordings of a sonar for ROS 2: one MCAP file a split, by the library rosbags."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ...common.errors import FactoryError
from ...common.ros_types import SONAR, typestore
from ...dataset.fan_geometry import FanGeometry, SonarDevice, drawn_sonar, recorded_sonar
from ...dataset.pair_dataset import PairDataset
from .notes import write_notes
from .samples import Sample, read_samples

_POSE = "geometry_msgs/msg/PoseStamped"
_IMAGE = "sensor_msgs/msg/Image"
_LAYERS = ("noisy", "clean")
_FRAME_ID = "sonar"
# Of frames whose recording states no time.
_PERIOD_S = 0.1
_PAUSE_S = 10.0
"""Between two scenes of a file."""
# Bags of time 0 count as undated in some programs: 2000-01-01.
_BEGIN_S = 946_684_800.0
_DTYPES = {"uint8": 0, "float32": 8}
_ENCODINGS = {"uint8": "mono8", "float32": "32FC1"}


class PolarGrid(NamedTuple):
    """The ranges (R,) in metres and bearings (B,) in radians, right positive, of a polar image."""

    ranges_m: npt.NDArray[np.float64]
    bearings_rad: npt.NDArray[np.float64]


def write_mcap(pairs: PairDataset, folder: Path) -> str:
    """SPLIT/SPLIT.mcap and its metadata.yaml, which `ros2 bag play SPLIT` takes.

    Topics: /sonar/noisy and /sonar/clean (ProjectedSonarImage: a row a range, a column a beam; a
    fan is sampled at the device's ranges and beams), /sonar/noisy/image and /sonar/clean/image
    (Image, as stored), and /sonar/pose (PoseStamped, frame `world`) where the dataset has
    `dataset.columns=[pose]` and its recordings have poses.
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
    store = typestore(2)
    count = 0
    for split in pairs.splits:
        writer = Writer(folder / split, version=9, storage_plugin=StoragePlugin.MCAP)
        with writer:
            connections: dict[str, Any] = {}
            for sample, time_s in _timed(read_samples(pairs, split)):
                count += 1
                for topic, kind, message in _messages(sample, time_s, sonar, store.types):
                    if topic not in connections:
                        connections[topic] = writer.add_connection(topic, kind, typestore=store)
                    content = store.serialize_cdr(message, kind)
                    writer.write(connections[topic], round(time_s * 1e9), content)
    write_notes(pairs, folder, _NOTES, layers=_LAYERS, has_records=False)
    return f"{len(pairs.splits)} MCAP files, {count} pings"


def _timed(split_samples: Iterator[Sample]) -> Iterator[tuple[Sample, float]]:
    """Each sample with its time: scenes one after another, with their own times inside."""
    scene: tuple[object, ...] | None = None
    begin_s = last_s = _BEGIN_S - _PAUSE_S
    first_s = 0.0
    for sample in split_samples:
        record = sample.record
        own_s = float(record.get("time_s", math.nan))
        key = (record["location"], record["scene"], record["variant"])
        if key[:2] != (scene or ())[:2]:
            begin_s = last_s + _PAUSE_S
            first_s = own_s
            scene = key
            last_s = begin_s
            yield sample, begin_s
            continue
        later_s = begin_s + own_s - first_s
        last_s = later_s if later_s > last_s else last_s + _PERIOD_S
        yield sample, last_s


def _messages(
    sample: Sample, time_s: float, sonar: SonarDevice, types: Mapping[str, Any]
) -> Iterator[tuple[str, str, Any]]:
    """Topic, type and message of all that is said of a sample."""
    seconds = int(time_s)
    stamp = types["builtin_interfaces/msg/Time"](
        sec=seconds, nanosec=min(round((time_s - seconds) * 1e9), 999_999_999)
    )
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=_FRAME_ID)
    sonar = drawn_sonar(sonar, sample.record)
    geometry = FanGeometry.from_record(sonar, sample.record)
    grid = polar_grid(sonar, geometry)
    for layer in _LAYERS:
        image = sample.images[layer]
        polar = polar_image(image, geometry, grid)
        yield f"/sonar/{layer}", SONAR, _ping(polar, grid, header, sonar, types)
        yield f"/sonar/{layer}/image", _IMAGE, _image(image, header, types)
    pose = _pose(sample.record, stamp, types)
    if pose is not None:
        yield "/sonar/pose", _POSE, pose


def polar_grid(sonar: SonarDevice, geometry: FanGeometry) -> PolarGrid:
    """The ranges and bearings that the device measures in the window of an image."""
    near = geometry.range_min_m
    far = geometry.range_max_m
    assert near is not None
    assert far is not None
    steps = (np.arange(sonar.range_bins) + 0.5) / sonar.range_bins
    return PolarGrid(near + steps * (far - near), sonar.beam_centres_rad().astype(np.float64))


def polar_image(
    image: npt.NDArray[Any], geometry: FanGeometry, grid: PolarGrid
) -> npt.NDArray[Any]:
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
    polar: npt.NDArray[Any], grid: PolarGrid, header: Any, sonar: SonarDevice,
    types: Mapping[str, Any],
) -> Any:  # fmt: skip
    direction = types["geometry_msgs/msg/Vector3"]
    data = types["marine_acoustic_msgs/msg/SonarImageData"](
        is_bigendian=False,
        dtype=_DTYPES[str(polar.dtype)],
        beam_count=polar.shape[1],
        data=np.ascontiguousarray(polar).reshape(-1).view(np.uint8),
    )
    info = types["marine_acoustic_msgs/msg/PingInfo"](
        frequency=1000 * sonar.frequency_khz,
        sound_speed=0.0,  # not needed to draw the image: ranges are metres
        tx_beamwidths=np.zeros(0, np.float32),
        rx_beamwidths=np.zeros(0, np.float32),
    )
    return types[SONAR](
        header=header,
        ping_info=info,
        beam_directions=[
            direction(x=0.0, y=math.sin(bearing), z=math.cos(bearing))
            for bearing in grid.bearings_rad.tolist()
        ],
        ranges=grid.ranges_m.astype(np.float32),
        image=data,
    )


def _image(image: npt.NDArray[Any], header: Any, types: Mapping[str, Any]) -> Any:
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
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="world")
    return types[_POSE](header=header, pose=pose)


_NOTES = """\
`SPLIT/SPLIT.mcap` opens in Foxglove; `ros2 bag play SPLIT` plays it. /sonar/noisy and /sonar/clean
are marine_acoustic_msgs/ProjectedSonarImage (a row a range, a column a beam), /sonar/noisy/image
and /sonar/clean/image the stored images. /sonar/pose is the sonar (x ahead, y left, z up) in the
world, where it is known. Scenes follow each other with a pause of 10 s; inside a scene times are
those of the recording, or a ping every .1 s.

```python
from simnfnd import open_recording

for frame in open_recording("train/train.mcap"):  # /sonar/clean and /sonar/noisy in turn
    print(frame.time_s, frame.image.shape, frame.geometry.range_max_m)
```
"""
