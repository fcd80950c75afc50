"""Recordings with their tracks, for trackers: MOTChallenge, and COCO with videos and tracks."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..dataset.pair_dataset import PairDataset
from ..dataset.reader import Split
from ..dataset.recordings import FrameSequence, Track
from ..dataset.schema import stored_image
from ..errors import FactoryError
from ..labels import classes_of
from .coco import list_categories, write_annotations
from .notes import write_notes
from .png_encoding import encode_png

_DEFAULT_RATE_HZ = 1.0


def _recordings(
    pairs: PairDataset, split: Split, classes: tuple[str, ...]
) -> Iterator[FrameSequence]:
    """The recordings of a split.

    Raises FactoryError for a dataset without tracks, and for a track of an unknown class.
    """
    if "tracks" not in {column.name for column in pairs.form.columns}:
        raise FactoryError(
            f"{pairs.folder} has no tracks; make it with moving objects and "
            "dataset.columns=[pose,tracks]"
        )
    with PairDataset(pairs.folder, split, layers=("noisy", "clean"), trusted=True) as chosen:
        for name in chosen.recordings.names:
            sequence = chosen.sequence(name)
            for track in itertools.chain.from_iterable(sequence.tracks):
                if track["class"] not in classes:
                    raise FactoryError(
                        f"{pairs.folder}: {name}: its tracks have a class {track['class']!r}, "
                        "which the dataset does not know"
                    )
            yield sequence


def _splits(pairs: PairDataset) -> list[Split]:
    known: tuple[Split, ...] = ("train", "test")
    return [split for split in known if split in pairs.splits]


def _shown(tracks: tuple[Track, ...]) -> Iterator[Track]:
    """The objects of a frame that have an echo in the image."""
    return (track for track in tracks if track["box"] is not None)


def _folder_name(recording: str) -> str:
    """A name that leads nowhere else, whatever a dataset calls its recordings."""
    return re.sub(r"[^A-Za-z0-9._-]|^\.+", "-", recording.replace("/", "-"))


def write_mot(pairs: PairDataset, folder: Path) -> str:
    """SPLIT/RECORDING/img1/NNNNNN.png, gt/gt.txt and seqinfo.ini.

    A line of gt.txt: frame (from 1), id, left, top (from 1), width, height, 1, class, visibility.
    Format: Milan et al., MOT16, arXiv 1603.00831.  Classes have the numbers of the dataset's.
    """
    classes = classes_of(pairs.form.config)
    counts: Counter[str] = Counter()
    for split in _splits(pairs):
        for sequence in _recordings(pairs, split, classes):
            place = folder / split / _folder_name(sequence.recording)
            (place / "img1").mkdir(parents=True)
            (place / "gt").mkdir()
            lines = []
            for number, tracks in enumerate(sequence.tracks, start=1):
                image = stored_image(sequence.noisy[number - 1], "uint8")
                (place / "img1" / f"{number:06d}.png").write_bytes(encode_png(image))
                lines += [_mot_line(number, track, classes) for track in _shown(tracks)]
            (place / "gt" / "gt.txt").write_text("".join(lines))
            (place / "seqinfo.ini").write_text(_sequence_info(sequence))
            counts.update(recordings=1, boxes=len(lines), frames=len(sequence))
    write_notes(pairs, folder, _MOT_NOTES)
    return f"{counts['recordings']} recordings, {counts['frames']} frames, {counts['boxes']} boxes"


def _mot_line(frame: int, track: Track, classes: tuple[str, ...]) -> str:
    left, top, width, height = track["box"]
    label = classes.index(track["class"])
    visibility = 1 - track["occluded"]
    box = f"{left + 1},{top + 1},{width},{height}"
    return f"{frame},{track['id']},{box},1,{label},{visibility:.3f}\n"


def _sequence_info(sequence: FrameSequence) -> str:
    height, width = sequence.noisy.shape[1:]
    return (
        f"[Sequence]\nname={_folder_name(sequence.recording)}\nimDir=img1\n"
        f"frameRate={frame_rate_hz(sequence):g}\nseqLength={len(sequence)}\n"
        f"imWidth={width}\nimHeight={height}\nimExt=.png\n"
    )


def frame_rate_hz(sequence: FrameSequence) -> float:
    """Frames a second; 1 where the dataset has no times."""
    span_s = float(sequence.time_s[-1] - sequence.time_s[0])
    if not span_s > 0:
        return _DEFAULT_RATE_HZ
    return round((len(sequence) - 1) / span_s, 6)


def write_coco_video(pairs: PairDataset, folder: Path) -> str:
    """images/SPLIT/RECORDING/NNNNNN.png and annotations/instances_SPLIT.json.

    As COCO has it, and beside it: videos; video_id and frame_id of images; video_id and track_id
    of annotations, track ids being unique in the file.
    """
    classes = classes_of(pairs.form.config)
    counts: Counter[str] = Counter()
    for split in _splits(pairs):
        document = _Document(classes)
        for sequence in _recordings(pairs, split, classes):
            name = _folder_name(sequence.recording)
            place = folder / "images" / split / name
            place.mkdir(parents=True)
            document.add(name, sequence)
            for number, noisy in enumerate(sequence.noisy, start=1):
                image = stored_image(noisy, "uint8")
                (place / f"{number:06d}.png").write_bytes(encode_png(image))
        write_annotations(document.values, folder, split)
        counts.update({key: len(document.values[key]) for key in ("videos", "images")})
        counts["boxes"] += len(document.values["annotations"])
    write_notes(pairs, folder, _COCO_VIDEO_NOTES)
    return f"{counts['videos']} recordings, {counts['images']} frames, {counts['boxes']} boxes"


class _Document:
    """The JSON of one split, filled recording by recording."""

    def __init__(self, classes: tuple[str, ...]) -> None:
        self._classes = classes
        self._track_ids: dict[tuple[int, int], int] = {}
        self.values: dict[str, list[dict[str, Any]]] = {
            "videos": [],
            "images": [],
            "annotations": [],
            "categories": list_categories(classes),
        }

    def add(self, name: str, sequence: FrameSequence) -> None:
        """Add a recording."""
        height, width = sequence.noisy.shape[1:]
        video_id = len(self.values["videos"]) + 1
        size = {"width": width, "height": height}
        self.values["videos"].append({"id": video_id, "name": name, **size})
        for number, tracks in enumerate(sequence.tracks, start=1):
            image_id = len(self.values["images"]) + 1
            image = {
                "id": image_id,
                "video_id": video_id,
                "frame_id": number,
                "file_name": f"{name}/{number:06d}.png",
                **size,
            }
            self.values["images"].append(image)
            for track in _shown(tracks):
                self.values["annotations"].append(self._annotation(track, image_id, video_id))

    def _annotation(self, track: Track, image_id: int, video_id: int) -> dict[str, Any]:
        key = video_id, track["id"]
        track_id = self._track_ids.setdefault(key, len(self._track_ids) + 1)
        _, _, width, height = track["box"]
        return {
            "id": len(self.values["annotations"]) + 1,
            "image_id": image_id,
            "video_id": video_id,
            "track_id": track_id,
            "category_id": self._classes.index(track["class"]),
            "bbox": track["box"],
            "area": width * height,
            "iscrowd": 0,
        }


_MOT_NOTES = """\
`SPLIT/RECORDING/` is a sequence of the MOTChallenge: `img1/000001.png` and so on, `seqinfo.ini`,
and `gt/gt.txt` with lines of frame, id, left, top, width, height, 1, class, visibility. Frames and
pixels count from 1; a class has its number in the dataset.
"""

_COCO_VIDEO_NOTES = """\
`annotations/instances_SPLIT.json` is COCO with recordings: `videos`; `video_id` and `frame_id` of
each image; `video_id` and `track_id` of each annotation. Boxes hold an object's echoes.
"""
