"""Recordings with their tracks, for trackers: MOTChallenge, and COCO with videos and tracks."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...common.errors import FactoryError
from ...dataset.meaning import classes_of
from ...dataset.pair_dataset import PairDataset
from ...dataset.reader import Split
from ...dataset.recordings import FrameSequence, Track, parse_tracks
from ...dataset.schema import stored_image
from .coco import IdCounters, describe_file, list_categories, write_annotations
from .notes import write_notes
from .object_selection import ClassList, ObjectSelection
from .png import encode_png

_DEFAULT_RATE_HZ = 1.0

MIN_SIDE_PX = 4
"""One pixel more or less halves the overlap of narrower boxes, by which trackers are judged."""

_MEASURES = ("range_m", "bearing_deg", "length_m", "body_bearing_deg")
"""What gt/tracks.csv says of an object in a frame; empty where an older dataset lacks it."""

_MOT_CLASS = 1
"""MOTChallenge judges this class alone, and results have no class."""


@dataclass(frozen=True, eq=False)
class ExportedTracks:
    """The boxes of an export: their classes, smallest size, and how many there are.

    min_side_px: smallest width and height of a box, pixels.
    counts: class -> number of boxes.  small_count: number of boxes that were left out.
    """

    classes: ClassList
    min_side_px: int
    counts: Mapping[str, int]
    small_count: int

    def shown(self, tracks: tuple[Track, ...]) -> Iterator[Track]:
        """The objects of a frame that the export holds."""
        return (
            track
            for track in tracks
            if track["class"] in self.classes and is_large(track, self.min_side_px)
        )

    def describe(self) -> str:
        """The number of boxes by class and the limit of size, as sentences for a README."""
        counts = ", ".join(f"{self.counts.get(name, 0)} {name}" for name in self.classes.names)
        return (
            f"Boxes: {counts}. {self.small_count} boxes narrower or lower than {self.min_side_px} "
            "pixels are left out."
        )

    def summarize(self, counts: Counter[str]) -> str:
        """What an export says of its recordings, frames and boxes."""
        return (
            f"{counts['recordings']} recordings, {counts['frames']} frames, "
            f"{sum(self.counts.values())} boxes; {self.small_count} narrower than "
            f"{self.min_side_px} pixels left out"
        )


def is_large(track: Track, min_side_px: int) -> bool:
    """Whether an object has a box that is wide and high enough."""
    if track["box"] is None:
        return False
    _, _, width, height = track["box"]
    return bool(min(width, height) >= min_side_px)


def survey_tracks(pairs: PairDataset, selection: ObjectSelection) -> ExportedTracks:
    """Read the tracks of all recordings, and choose and count the boxes of an export.

    Raises FactoryError for a dataset without tracks, a track of an unknown class, and classes of
    the selection that the dataset does not know.
    """
    if "tracks" not in {column.name for column in pairs.form.columns}:
        raise FactoryError(
            f"{pairs.folder} has no tracks; make it with moving objects and "
            "dataset.columns=[pose,tracks]"
        )
    known = classes_of(pairs.form.config)
    min_side_px = selection.min_side_px or MIN_SIDE_PX
    large_counts: Counter[str] = Counter()
    small_counts: Counter[str] = Counter()
    for track in _recorded_tracks(pairs):
        name = track["class"]
        if name not in known:
            raise FactoryError(
                f"{pairs.folder}: its tracks have a class {name!r}, which the dataset does not know"
            )
        if track["box"] is not None:
            counts = large_counts if is_large(track, min_side_px) else small_counts
            counts[name] += 1
    classes = selection.list_classes(known, large_counts)
    is_listed = classes if selection.class_names else ClassList(known)
    return ExportedTracks(
        classes=classes,
        min_side_px=min_side_px,
        counts={name: large_counts[name] for name in classes.names},
        small_count=sum(count for name, count in small_counts.items() if name in is_listed),
    )


def _recorded_tracks(pairs: PairDataset) -> Iterator[Track]:
    """The moving objects of all frames; recordings hold the first variant of the noise alone."""
    for sample, record in enumerate(pairs.meta()):
        if int(record["variant"]) == 0:
            yield from parse_tracks(record["tracks"], f"{pairs.folder}: sample {sample}")


def _recordings(pairs: PairDataset, split: Split) -> Iterator[FrameSequence]:
    """The recordings of a split."""
    with PairDataset(pairs.folder, split, layers=("noisy", "clean"), trusted=True) as chosen:
        for name in chosen.recordings.names:
            yield chosen.sequence(name)


def _splits(pairs: PairDataset) -> list[Split]:
    known: tuple[Split, ...] = ("train", "test")
    return [split for split in known if split in pairs.splits]


def _folder_name(recording: str) -> str:
    """A name that leads nowhere else, whatever a dataset calls its recordings."""
    return re.sub(r"[^A-Za-z0-9._-]|^\.+", "-", recording.replace("/", "-"))


def _unused_name(folder: Path, recording: str) -> str:
    """The name of a recording's folder, numbered where another recording took it."""
    plain_name = _folder_name(recording)
    name = plain_name
    number = 2
    while (folder / name).exists():
        name = f"{plain_name}-{number}"
        number += 1
    return name


def write_mot(pairs: PairDataset, folder: Path, selection: ObjectSelection) -> str:
    """SPLIT/RECORDING/img1/NNNNNN.png, gt/*.txt and gt/*.csv, and seqinfo.ini.

    A line of gt.txt: frame (from 1), id, left, top (from 1), width, height, 1, class, visibility.
    Format: Milan et al., MOT16, arXiv 1603.00831.  Every object has class 1, the only one that
    MOTChallenge's tools judge by default; classes of the selection are numbered from 1.
    Raises FactoryError for a dataset without tracks.
    """
    exported = survey_tracks(pairs, selection)
    numbers = dict.fromkeys(exported.classes.names, _MOT_CLASS)
    if selection.class_names:
        numbers = {name: exported.classes.number(name) for name in exported.classes.names}
    counts: Counter[str] = Counter()
    for split in _splits(pairs):
        for sequence in _recordings(pairs, split):
            _write_mot_sequence(sequence, folder / split, exported, numbers)
            counts.update(recordings=1, frames=len(sequence))
    class_numbers = f"Class numbers: {_describe_numbers(numbers)}. {exported.describe()}"
    notes = f"{_MOT_NOTES}\n{class_numbers}\n"
    write_notes(pairs, folder, notes, layers=("noisy",), has_records=False)
    return exported.summarize(counts)


def _describe_numbers(numbers: Mapping[str, int]) -> str:
    return ", ".join(f"{number} {name}" for name, number in numbers.items())


def _write_mot_sequence(
    sequence: FrameSequence, folder: Path, exported: ExportedTracks, numbers: Mapping[str, int]
) -> None:
    name = _unused_name(folder, sequence.recording)
    place = folder / name
    (place / "img1").mkdir(parents=True)
    (place / "gt").mkdir()
    lines = []
    truth: list[tuple[Any, ...]] = []
    class_names: dict[int, str] = {}
    for frame_number, tracks in enumerate(sequence.tracks, start=1):
        image = stored_image(sequence.noisy[frame_number - 1], "uint8")
        (place / "img1" / f"{frame_number:06d}.png").write_bytes(encode_png(image))
        for track in exported.shown(tracks):
            lines.append(_mot_line(frame_number, track, numbers[track["class"]]))
            class_names[track["id"]] = track["class"]
            measures = (track.get(name, "") for name in _MEASURES)
            truth.append((frame_number, track["id"], *measures))
    (place / "gt" / "gt.txt").write_text("".join(lines))
    _write_csv(place / "gt" / "classes.csv", [("id", "class"), *sorted(class_names.items())])
    _write_csv(place / "gt" / "tracks.csv", [("frame", "id", *_MEASURES), *truth])
    (place / "seqinfo.ini").write_text(_sequence_info(sequence, name))


def _write_csv(path: Path, rows: list[tuple[Any, ...]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows(rows)


def _mot_line(frame_number: int, track: Track, class_number: int) -> str:
    left, top, width, height = track["box"]
    visibility = 1 - track["occluded"]
    box = f"{left + 1},{top + 1},{width},{height}"
    return f"{frame_number},{track['id']},{box},1,{class_number},{visibility:.3f}\n"


def _sequence_info(sequence: FrameSequence, name: str) -> str:
    """seqinfo.ini; tools read frameRate as a whole number, so the exact one stands at the end."""
    height, width = sequence.noisy.shape[1:]
    rate_hz = frame_rate_hz(sequence)
    return (
        f"[Sequence]\nname={name}\nimDir=img1\n"
        f"frameRate={max(round(rate_hz), 1)}\nseqLength={len(sequence)}\n"
        f"imWidth={width}\nimHeight={height}\nimExt=.png\nexactFrameRate={rate_hz:g}\n"
    )


def frame_rate_hz(sequence: FrameSequence) -> float:
    """Frames a second, those that failed included; 1 where the dataset has no times."""
    steps_s = np.diff(sequence.time_s)
    if not len(steps_s) or not (steps_s > 0).all():
        return _DEFAULT_RATE_HZ
    return round(float(1 / np.median(steps_s)), 6)


def write_coco_video(pairs: PairDataset, folder: Path, selection: ObjectSelection) -> str:
    """images/SPLIT/RECORDING/NNNNNN.png and annotations/instances_SPLIT.json.

    As COCO has it, and beside it: videos; video_id and frame_id of images; video_id and track_id
    of annotations.  All ids are unique over the splits.  Categories are the classes that occur, or
    those of the selection, numbered from 1.
    Raises FactoryError for a dataset without tracks.
    """
    exported = survey_tracks(pairs, selection)
    counts: Counter[str] = Counter()
    ids = IdCounters()
    for split in _splits(pairs):
        document = _Document(exported, split, ids)
        for sequence in _recordings(pairs, split):
            name = _unused_name(folder / "images" / split, sequence.recording)
            place = folder / "images" / split / name
            place.mkdir(parents=True)
            document.add(name, sequence)
            for number, noisy in enumerate(sequence.noisy, start=1):
                image = stored_image(noisy, "uint8")
                (place / f"{number:06d}.png").write_bytes(encode_png(image))
            counts.update(recordings=1, frames=len(sequence))
        write_annotations(document.values, folder, split)
    class_numbers = f"Categories: {exported.classes.describe()}. {exported.describe()}"
    notes = f"{_COCO_VIDEO_NOTES}\n{class_numbers}\n"
    write_notes(pairs, folder, notes, layers=("noisy",), has_records=False)
    return exported.summarize(counts)


class _Document:
    """The JSON of one split, filled recording by recording; ids go on from split to split."""

    def __init__(self, exported: ExportedTracks, split: str, ids: IdCounters) -> None:
        self._exported = exported
        self._ids = ids
        self._track_ids: dict[tuple[int, int], int] = {}
        self.values: dict[str, Any] = {
            "info": describe_file(f"SimNFND, {split}; recordings with tracks"),
            "videos": [],
            "images": [],
            "annotations": [],
            "licenses": [],
            "categories": list_categories(exported.classes),
        }

    def add(self, name: str, sequence: FrameSequence) -> None:
        """Add a recording."""
        height, width = sequence.noisy.shape[1:]
        video_id = next(self._ids.videos)
        size = {"width": width, "height": height}
        self.values["videos"].append({"id": video_id, "name": name, **size})
        for number, tracks in enumerate(sequence.tracks, start=1):
            image_id = next(self._ids.images)
            image = {
                "id": image_id,
                "video_id": video_id,
                "frame_id": number,
                "file_name": f"{name}/{number:06d}.png",
                **size,
            }
            self.values["images"].append(image)
            for track in self._exported.shown(tracks):
                self.values["annotations"].append(self._annotation(track, image_id, video_id))

    def _annotation(self, track: Track, image_id: int, video_id: int) -> dict[str, Any]:
        key = video_id, track["id"]
        if key not in self._track_ids:
            self._track_ids[key] = next(self._ids.tracks)
        _, _, width, height = track["box"]
        return {
            "id": next(self._ids.annotations),
            "image_id": image_id,
            "video_id": video_id,
            "track_id": self._track_ids[key],
            "category_id": self._exported.classes.number(track["class"]),
            "bbox": track["box"],
            "area": width * height,
            "iscrowd": 0,
        }


_MOT_NOTES = """\
`SPLIT/RECORDING/` is a sequence of the MOTChallenge: `img1/000001.png` and so on, `seqinfo.ini`,
and `gt/gt.txt` with lines of frame, id, left, top, width, height, 1, class, visibility. Frames and
pixels count from 1. `gt/classes.csv` names the class of each id, `gt/tracks.csv` gives range,
bearing, length and body axis in each frame. TrackEval at its defaults judges class 1 (its
"pedestrian"), which all objects have unless `--classes` named classes; with several numbers, set
its `DO_PREPROC False` to judge them together.
"""

_COCO_VIDEO_NOTES = """\
`images/SPLIT/RECORDING/` holds the noisy images, `annotations/instances_SPLIT.json` is COCO with
recordings: `videos`; `video_id` and `frame_id` of each image; `video_id` and `track_id` of each
annotation. Boxes hold an object's echoes, in pixels from 0. `frame_id` counts from 1, and ids are
unique over the splits.
"""
