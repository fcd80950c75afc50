"""Files that `simnfnd detect` writes: COCO, a table, and images or videos with boxes."""

from __future__ import annotations

import csv
import io
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Self

import cv2
import numpy as np

from ...factory.common.array_types import UInt8s
from ...factory.common.errors import FrameError
from ...factory.common.files import write_atomically
from ..recordings.plain_video import PlainVideo, plain_video
from .frames import ShownFrame
from .objects import DetectedObject

COLUMNS = (
    "file", "frame", "time_s", "class", "score", "left", "top", "width", "height",
    "slant_range_m", "bearing_deg", "size_m",
)  # fmt: skip
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_COLOURS = ((60, 220, 60), (60, 200, 255), (255, 160, 60), (220, 90, 220), (90, 220, 220))  # BGR
_READABLE_PX = 480  # shorter images are enlarged before boxes and names are drawn


class FrameRow(NamedTuple):
    """A frame in the results, with its objects.

    file: of the input.  height, width: of the image, in whose pixels the boxes are.
    """

    file: str
    is_image: bool
    frame: int
    time_s: float | None
    height: int
    width: int
    objects: list[DetectedObject]

    @classmethod
    def of(
        cls, file: str, is_image: bool, frame: ShownFrame, objects: list[DetectedObject]
    ) -> Self:
        """The row of a frame."""
        height, width = frame.image.shape
        return cls(file, is_image, frame.number, frame.time_s, height, width, objects)

    @property
    def image_name(self) -> str:
        """`file_name` of the frame: of a recording with the number of the frame."""
        return self.file if self.is_image else f"{self.file}/{self.frame:06d}.png"


def write_rows(path: Path, rows: Iterable[FrameRow]) -> None:
    """Keep the rows of an input, for a run that goes on after an interruption."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, json.dumps(list(rows)).encode(), key="--out")


def read_rows(path: Path) -> list[FrameRow]:
    """The rows that `write_rows` kept.  Raises FrameError when the file is damaged."""
    try:
        return [
            FrameRow._make([*values, [DetectedObject._make(item) for item in objects]])
            for *values, objects in json.loads(path.read_text(encoding="utf-8"))
        ]
    except (OSError, ValueError, TypeError) as error:
        raise FrameError(f"{path}: damaged; run with --again") from error


def write_results(out: Path, rows: Sequence[FrameRow], classes: Sequence[str]) -> None:
    """Write detections.json (COCO), results.json (COCO's bare list) and detections.csv."""
    number_of = {name: number for number, name in enumerate(classes, start=1)}
    images = []
    annotations: list[dict[str, Any]] = []
    for image_id, row in enumerate(rows, start=1):
        images.append(
            {
                "id": image_id,
                "file_name": row.image_name,
                "width": row.width,
                "height": row.height,
                "file": row.file,
                "frame": row.frame,
                "time_s": row.time_s,
            }
        )
        for found in row.objects:
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": image_id,
                    "category_id": number_of[found.class_name],
                    **_box_entries(found),
                    "iscrowd": 0,
                }
            )
    document = {
        "info": {"description": "Detections of SimNFND; every annotation has a score"},
        "images": images,
        "annotations": annotations,
        "categories": [{"id": number, "name": name} for name, number in number_of.items()],
    }
    names = ("image_id", "category_id", "bbox", "score")
    bare = [{name: entry[name] for name in names} for entry in annotations]
    write_atomically(out / "detections.json", json.dumps(document).encode(), key="--out")
    write_atomically(out / "results.json", json.dumps(bare).encode(), key="--out")
    write_atomically(out / "detections.csv", os.fsencode(_table(rows)), key="--out")


def _box_entries(found: DetectedObject) -> dict[str, Any]:
    width = found.right - found.left
    height = found.bottom - found.top
    return {
        "bbox": [round(value, 2) for value in (found.left, found.top, width, height)],
        "area": round(width * height, 2),
        "score": round(found.score, 4),
    }


def _table(rows: Iterable[FrameRow]) -> str:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    for row in rows:
        time_s = "" if row.time_s is None else f"{row.time_s:.3f}"
        for found in row.objects:
            entries = _box_entries(found)
            place = (found.slant_range_m, found.bearing_deg, found.size_m)
            measured = ("" if value is None else f"{value:.3f}" for value in place)
            head = (row.file, row.frame, time_s, found.class_name, entries["score"])
            table.writerow([*head, *entries["bbox"], *measured])
    return text.getvalue()


class Overlay:
    """Images of one input with their boxes: a picture, or a video of a recording."""

    def __init__(self, path: Path, video: PlainVideo | None) -> None:
        self._path = path
        self._video = video

    def add(self, frame: ShownFrame, labelled: Sequence[tuple[DetectedObject, str]]) -> None:
        """The next frame.  labelled: objects with the text beside each."""
        image = draw_boxes(frame.image, labelled)
        if self._video is not None:
            self._video.add(image, frame.time_s)
            return
        _, content = cv2.imencode(".png", image)
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(self._path, content.tobytes(), key="--out")


@contextmanager
def open_overlay(path: Path, *, is_image: bool) -> Iterator[Overlay]:
    """The overlay of an input, at `path` and a suffix when the block ends without an error."""
    if is_image:
        yield Overlay(path.with_name(f"{path.name}.png"), None)
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    with plain_video(path.with_name(f"{path.name}.mp4")) as video:
        yield Overlay(path, video)


def draw_boxes(image: UInt8s, labelled: Sequence[tuple[DetectedObject, str]]) -> UInt8s:
    """A colour image (H, W, 3), blue first, with boxes and the text of each; small ones enlarged.

    image: (H, W).
    """
    scale = max(1, -(-_READABLE_PX // max(image.shape)))
    size = (image.shape[1] * scale, image.shape[0] * scale)
    enlarged = cv2.resize(image, size, interpolation=cv2.INTER_NEAREST)
    drawn: UInt8s = np.repeat(np.asarray(enlarged, np.uint8)[..., None], 3, axis=2)
    names = sorted({text.split()[0] for _, text in labelled})
    for found, text in labelled:
        colour = _COLOURS[names.index(text.split()[0]) % len(_COLOURS)]
        corners = np.rint(np.array(found[2:6]) * scale).astype(int)
        left, top, right, bottom = corners.tolist()
        cv2.rectangle(drawn, (left, top), (right, bottom), colour, 1, cv2.LINE_AA)
        position = (max(2, left), top - 4 if top > 14 else bottom + 12)
        cv2.putText(drawn, text, position, _FONT, 0.4, colour, 1, cv2.LINE_AA)
    return drawn
