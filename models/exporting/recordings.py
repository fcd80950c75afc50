"""`simnfnd export RECORDING --to mp4|png|csv|mcap`: recorded or denoised, for other software.

A video that any player shows, an image of each frame, a table of frames with their times and what
the file says of sonar and pose, or a bag of ROS 2.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.command_line import Parser
from ...factory.common.errors import FactoryError
from ...factory.common.extras import Need, require
from ...factory.common.files import explain_os_errors, refuse_files, whole_file, whole_folder
from ...factory.common.progress import Bar
from ...factory.common.ros_types import SONAR
from ...factory.production.commands.export import main as export_dataset
from ...factory.production.export.ros_messages import (
    PingFacts,
    PingGrid,
    image_message,
    ping_message,
)
from ..recordings import Recording, SonarFrame, dataset_of, is_recording, open_recording
from ..recordings.base import FULL_SCALE, RecordingDevice, SonarPose
from ..recordings.views import fan_of, grey_of, polar_geometry

FORMATS = ("mp4", "png", "csv", "mcap")
_FOLDERS = ("png", "mcap")
_NEEDS = {"mp4": ("av", "cv2"), "png": ("cv2",), "csv": (), "mcap": ("rosbags", "cv2")}
_POLAR = "_polar.png"
_PERIOD_S = 0.1  # of recordings without times
_LEAST_CLOCK_S = 1e8  # seconds since 1970; less counts from the start of the recording
_FRAME_COLUMNS = (
    "frame", "file", "time_s", "time_utc", "duration_s", "rows", "columns", "beams",
    "range_min_m", "range_max_m", "opening_deg",
)  # fmt: skip
_POSE_COLUMNS = tuple(field.name for field in fields(SonarPose))
_DEVICE_COLUMNS = {f"device_{field.name}": field.name for field in fields(RecordingDevice)}
_HELP = """\
RECORDING (ARIS, DDF, Oculus, a bag, a video, a stack, arrays, a folder of images or of recordings;
recorded or denoised) instead of a dataset:
  --to mp4    a video that any player shows, pings as fans; lossy, for viewing
  --to png    an image of each frame, pings as fans
  --to csv    a table of frames: number, times, range window, pose and device
  --to mcap   a bag of ROS 2: pings as ProjectedSonarImage, images as Image
  --out       a new folder, or the name of the .mp4 or .csv file
  --topic     topic of a bag to export (may be repeated)

A dataset:
"""


def main(words: Sequence[str]) -> int:
    """`simnfnd export`, of a recording or, by the factory's command, of a dataset."""
    arguments = list(words)
    if "-h" in arguments or "--help" in arguments:
        print(_HELP)
        export_dataset(arguments)
        return 0
    chosen = _chosen(arguments)
    if chosen is None:
        export_dataset(arguments)
        return 0
    for recording in _recordings_in(chosen):
        _export(recording)
    return 0


def _recordings_in(chosen: _Chosen) -> list[_Chosen]:
    """What to export: the recording, or each one of a folder, into a folder of files."""
    folder = chosen.source
    if not folder.is_dir() or is_recording(folder):
        return [chosen]
    sources = [path for path in sorted(folder.iterdir()) if is_recording(path)]
    if not sources:
        return [chosen]
    is_folder = chosen.format in _FOLDERS
    out = chosen.target if is_folder else chosen.target.parent
    if not is_folder and chosen.target.stem != folder.name:
        raise FactoryError(f"--out {chosen.target}: {folder} holds recordings; give a folder")
    suffix = "" if is_folder else f".{chosen.format}"
    targets = [out / f"{source.name}{suffix}" for source in sources]
    for target in targets:
        if target.exists():
            raise FactoryError(f"--out {target}: is there already; give another name")
    return [
        chosen._replace(source=source, target=target)
        for source, target in zip(sources, targets, strict=True)
    ]


def _export(chosen: _Chosen) -> None:
    """Export one recording."""
    require(Need(f"--to {chosen.format}", module) for module in _NEEDS[chosen.format])
    write = {
        "mp4": _write_video,
        "png": _write_images,
        "csv": _write_table,
        "mcap": _write_bag,
    }[chosen.format]
    with open_recording(chosen.source, chosen.topics) as recording:
        count = write(recording, chosen)
        if recording.warning:
            print(f"warning: {recording.warning}")
    print(f"export: {count} frames")
    print(f"{'folder' if chosen.target.is_dir() else 'file'}: {chosen.target}")


class _Chosen(NamedTuple):
    source: Path
    format: str
    target: Path
    topics: tuple[str, ...]


def _chosen(words: list[str]) -> _Chosen | None:
    """What is asked of a recording; None where the words are of a dataset."""
    parser = Parser(prog="simnfnd export")
    parser.add_argument("source", type=Path)
    parser.add_argument("--to", required=True)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--topic", action="append", default=[])
    options, others = parser.parse_known_args(words)
    source = options.source.expanduser()
    is_dataset = dataset_of(source) == source
    if options.to not in FORMATS:
        if not is_dataset and is_recording(source):
            raise FactoryError(
                f"--to {options.to}: is for datasets; recordings become {', '.join(FORMATS)}"
            )
        return None
    # A video or table of a dataset is that of its recording; folders are the dataset's export.
    if options.to in _FOLDERS and (is_dataset or not (source.exists() or dataset_of(source))):
        return None
    if others:
        raise FactoryError(f"{others[0]}: belongs to the export of datasets; leave it out")
    out = options.out.expanduser()
    target = out
    if options.to not in _FOLDERS and out.suffix.lower() != f".{options.to}":
        refuse_files(out)
        target = out / f"{source.stem}.{options.to}"
    elif options.to in _FOLDERS:
        refuse_files(out)
    if target.is_file():
        raise FactoryError(f"--out {target}: is there already; give another name")
    return _Chosen(source, options.to, target, tuple(options.topic))


def _frames(recording: Recording) -> Iterator[SonarFrame]:
    """All frames under a progress bar; of folders of `denoise` the fans and not their samples."""
    names = {path.name for path in recording.files}
    with Bar(total=recording.count, unit="frame", desc="export") as bar:
        for frame in recording:
            bar.update()
            file = recording.files[frame.number] if recording.files else None
            is_polar = file is not None and file.name.endswith(_POLAR)
            if is_polar and file is not None and file.name.replace(_POLAR, ".png") in names:
                continue
            yield frame


def _write_video(recording: Recording, chosen: _Chosen) -> int:
    from ..denoise.writers import in_colour
    from ..recordings.plain_video import plain_video

    count = 0
    with plain_video(chosen.target) as video:
        for frame in _frames(recording):
            video.add(in_colour(_image_of(frame)), frame.time_s)
            count += 1
    return count


def _write_images(recording: Recording, chosen: _Chosen) -> int:
    from ..denoise.writers import write_image

    count = 0
    with whole_folder(chosen.target) as folder:
        for frame in _frames(recording):
            write_image(folder / f"{frame.number:06d}.png", _image_of(frame))
            count += 1
    return count


def _write_bag(recording: Recording, chosen: _Chosen) -> int:
    from ...factory.production.export.ros_messages import IMAGE, PING_FRAME, Bag, stamp_at

    count = 0
    with (
        whole_folder(chosen.target) as folder,
        Bag(folder / chosen.source.stem) as bag,
    ):
        for frame in _frames(recording):
            time_s = count * _PERIOD_S if frame.time_s is None else frame.time_s
            stamp = stamp_at(time_s, bag.types)
            header = bag.types["std_msgs/msg/Header"](stamp=stamp, frame_id=PING_FRAME)
            if frame.beams is None:
                image = image_message(_bytes_or_floats(frame), header, bag.types)
                bag.write(time_s, [("/sonar/image", IMAGE, image)])
            else:
                bag.write(time_s, [("/sonar", SONAR, _ping_of(frame, header, bag.types))])
            count += 1
    return count


def _ping_of(frame: SonarFrame, header: Any, types: Mapping[str, Any]) -> Any:
    assert frame.beams is not None
    samples = _bytes_or_floats(frame)
    beams = frame.beams
    bin_m = (beams.range_max_m - beams.range_min_m) / len(samples)
    ranges_m = beams.range_min_m + bin_m * (np.arange(len(samples)) + 0.5)
    grid = PingGrid(ranges_m, np.asarray(beams.azimuths_rad, np.float64))
    facts = PingFacts(frame.device.sound_speed_m_s or 0.0, 0.0, 0.0)
    frequency_hz = 1000 * (frame.device.frequency_khz or 0.0)
    return ping_message(samples, grid, header, frequency_hz, facts, types)


def _bytes_or_floats(frame: SonarFrame) -> Array:
    """(H, W) grey values: uint8 as stored, others float32 in 0..1."""
    samples = frame.samples
    return samples if samples.dtype == np.uint8 and samples.ndim == 2 else grey_of(frame)


def _image_of(frame: SonarFrame) -> Any:
    """A frame as it is looked at, uint8 or uint16; pings as fans, float32 in 16 bits."""
    samples = frame.samples
    stored = "uint16" if samples.dtype == np.float32 else str(samples.dtype)
    image = samples
    if frame.beams is not None:
        image = fan_of(grey_of(frame), frame.beams)[0]
    if image.dtype != np.float32:
        return image
    return np.rint(np.clip(image, 0, 1) * FULL_SCALE[stored]).astype(stored)


def _write_table(recording: Recording, chosen: _Chosen) -> int:
    columns = (*_FRAME_COLUMNS, *_POSE_COLUMNS, *_DEVICE_COLUMNS)
    count = 0
    with (
        whole_file(chosen.target) as partial,
        explain_os_errors(chosen.target, "--out"),
        partial.open("w", newline="", encoding="utf-8", errors="surrogateescape") as file,
    ):
        table = csv.DictWriter(file, columns, lineterminator="\n")
        table.writeheader()
        for frame in _frames(recording):
            path = recording.files[frame.number] if recording.files else recording.path
            table.writerow(_row_of(frame, path.name))
            count += 1
    return count


def _row_of(frame: SonarFrame, name: str) -> dict[str, Any]:
    """What is not known is empty."""
    rows, columns = frame.samples.shape[:2]
    row: dict[str, Any] = {"frame": frame.number, "file": name, "rows": rows, "columns": columns}
    row["time_s"] = frame.time_s
    row["duration_s"] = frame.duration_s
    if frame.time_s is not None and frame.time_s > _LEAST_CLOCK_S:
        row["time_utc"] = datetime.fromtimestamp(frame.time_s, UTC).isoformat()
    if frame.beams is not None:
        geometry = polar_geometry(frame.beams, rows)
        row["beams"] = len(frame.beams.azimuths_rad)
        row["range_min_m"] = frame.beams.range_min_m
        row["range_max_m"] = frame.beams.range_max_m
        row["opening_deg"] = math.degrees(geometry.azimuth_max_rad - geometry.azimuth_min_rad)
    row |= asdict(frame.pose)
    row |= {column: getattr(frame.device, name) for column, name in _DEVICE_COLUMNS.items()}
    return row
