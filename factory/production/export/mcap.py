"""Datasets as recordings of a sonar for ROS 2: one MCAP file a split, by the library rosbags."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ...common.errors import FactoryError
from ...common.ros_types import SONAR
from ...dataset.fan_geometry import FanGeometry, SonarDevice, drawn_sonar, recorded_sonar
from ...dataset.pair_dataset import PairDataset
from .notes import write_notes
from .ros_messages import (
    IMAGE,
    PING_FRAME,
    POSE,
    STATIC,
    TRANSFORMS,
    Bag,
    image_message,
    ping_axes,
    ping_facts,
    ping_message,
    polar_grid,
    polar_image,
    pose_message,
    stamp_at,
    transform,
)
from .samples import ExportedSample, read_samples

_LAYERS = ("noisy", "clean")
# Period of frames whose recording states no time.
_PERIOD_S = 0.1
_PAUSE_S = 10.0
"""Between two scenes of a file."""
# Bags of time 0 count as undated in some programs: 2000-01-01.
_BEGIN_S = 946_684_800.0
_LEAST_CLOCK_S = 1e8
"""Times of recordings from which on they are seconds since 1970."""


def write_mcap(pairs: PairDataset, folder: Path) -> str:
    """SPLIT/SPLIT.mcap and its metadata.yaml, which `ros2 bag play SPLIT` takes.

    Topics: /sonar/noisy and /sonar/clean (ProjectedSonarImage: one row per range, one column per
    beam; a fan is sampled at the device's ranges and beams), /sonar/noisy/image and
    /sonar/clean/image (Image, as stored), /tf_static (where the axes of pings lie in the sonar),
    and /sonar/pose (PoseStamped) and /tf where the dataset has `dataset.columns=[pose]` and its
    recordings have poses.
    Raises FactoryError for a dataset whose device is not known.
    """
    sonar = recorded_sonar(pairs.form.config)
    devices = pairs.form.config.get("devices") or {}
    if sonar is None or devices.get("field_share") is not None:
        raise FactoryError(
            f"{pairs.folder}: some of its images are points seen from above, which have no ranges "
            "and beams; export with --to png"
        )
    config = pairs.form.config
    count = 0
    for split in pairs.splits:
        with Bag(folder / split) as bag:
            for sample, time_s in _timed(read_samples(pairs, split)):
                count += 1
                bag.write(time_s, _messages(sample, time_s, sonar, config, bag.types))
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
    stamp = stamp_at(time_s, types)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id=PING_FRAME)
    yield STATIC, TRANSFORMS, ping_axes(stamp, types)
    sonar = drawn_sonar(sonar, sample.record)
    facts = ping_facts(config, sonar)
    geometry = FanGeometry.from_record(sonar, sample.record)
    grid = polar_grid(sonar, geometry)
    for layer in _LAYERS:
        image = sample.images[layer]
        polar = polar_image(image, geometry, grid)
        frequency_hz = 1000 * sonar.frequency_khz
        message = ping_message(polar, grid, header, frequency_hz, facts, types)
        yield f"/sonar/{layer}", SONAR, message
        yield f"/sonar/{layer}/image", IMAGE, image_message(image, header, types)
    pose = pose_message(sample.record, stamp, types)
    if pose is not None:
        yield "/sonar/pose", POSE, pose
        yield "/tf", TRANSFORMS, transform(pose.pose, stamp, types)


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
