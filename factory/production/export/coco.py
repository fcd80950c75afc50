"""Images and their objects for detectors, in the format of COCO."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from ...common.array_types import Bools
from ...dataset.pair_dataset import PairDataset
from .notes import write_notes
from .object_selection import ClassList, ObjectSelection
from .objects import (
    ExportedImage,
    ExportedObjects,
    VisibleObject,
    survey_objects,
    write_labelled_images,
)


def write_coco(pairs: PairDataset, folder: Path, selection: ObjectSelection) -> str:
    """images/SPLIT/KEY.png and annotations/instances_SPLIT.json, with boxes and masks.

    Categories are the classes that occur, or those of the selection, numbered from 1.  clean/SPLIT
    holds the clean images.  Format: https://cocodataset.org/#format-data.
    Raises FactoryError for a dataset without labels.
    """
    exported = survey_objects(pairs, selection)
    ids = IdCounters()
    for split in pairs.splits:
        annotations = _SplitAnnotations(pairs, exported, ids)
        for image in write_labelled_images(pairs, folder, split, exported):
            annotations.add(image)
        write_annotations(annotations.document(split), folder, split)
    notes = f"{_NOTES}\n{exported.describe()}\n"
    write_notes(pairs, folder, notes, layers=("noisy", "clean"), has_records=False)
    return exported.summarize(len(pairs))


def _counter() -> Iterator[int]:
    return count(1)


@dataclass(frozen=True)
class IdCounters:
    """The next id of each kind, from 1; no id comes twice in the splits of an export."""

    videos: Iterator[int] = field(default_factory=_counter)
    images: Iterator[int] = field(default_factory=_counter)
    annotations: Iterator[int] = field(default_factory=_counter)
    tracks: Iterator[int] = field(default_factory=_counter)


class _SplitAnnotations:
    """The images and annotations of one split, filled image by image."""

    def __init__(self, pairs: PairDataset, exported: ExportedObjects, ids: IdCounters) -> None:
        self._ids = ids
        self._height, self._width = pairs.shape
        self._classes = exported.classes
        self._images: list[dict[str, Any]] = []
        self._annotations: list[dict[str, Any]] = []

    def add(self, image: ExportedImage) -> None:
        """Add an image and its objects."""
        image_id = next(self._ids.images)
        image_entry = {
            "id": image_id,
            "file_name": f"{image.key}.png",
            "width": self._width,
            "height": self._height,
        }
        self._images.append(image_entry)
        for shown in image.objects:
            self._annotations.append(self._annotation(shown, image_id))

    def _annotation(self, shown: VisibleObject, image_id: int) -> dict[str, Any]:
        return {
            "id": next(self._ids.annotations),
            "image_id": image_id,
            "category_id": self._classes.number(shown.class_name),
            "bbox": shown.box,
            "area": shown.area_px,
            "segmentation": encode_run_lengths(shown.mask),
            "iscrowd": 0,
        }

    def document(self, split: str) -> dict[str, Any]:
        """The whole file of annotations."""
        return {
            "info": describe_file(f"SimNFND, {split}; masks as run lengths"),
            "images": self._images,
            "annotations": self._annotations,
            "licenses": [],
            "categories": list_categories(self._classes),
        }


def describe_file(description: str) -> dict[str, str]:
    """The entry `info`, without which pycocotools 2.0.9 and 2.0.10 read no results."""
    return {"description": description, "version": "1.0"}


def list_categories(classes: ClassList) -> list[dict[str, Any]]:
    """The categories of COCO, numbered from 1."""
    return [
        {"id": classes.number(name), "name": name, "supercategory": "object"}
        for name in classes.names
    ]


def write_annotations(document: dict[str, Any], folder: Path, split: str) -> None:
    """Write annotations/instances_SPLIT.json."""
    (folder / "annotations").mkdir(exist_ok=True)
    text = json.dumps(document, separators=(",", ":"))
    (folder / "annotations" / f"instances_{split}.json").write_text(text + "\n")


def encode_run_lengths(mask: Bools) -> dict[str, list[int]]:
    """(H, W) as COCO's uncompressed runs: of 0, of 1, of 0, ... down each column in turn."""
    flat_mask = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat_mask, prepend=False))
    run_lengths = np.diff(changes, prepend=0, append=flat_mask.size)
    return {"counts": run_lengths.tolist(), "size": list(mask.shape)}


_NOTES = """\
`annotations/instances_SPLIT.json` holds, in the format of COCO, the objects in the images of
`images/SPLIT`: box, area in pixels, and the mask as run lengths, which pycocotools reads
(`annToMask`); `--to yolo` has polygons. `clean/SPLIT` has the same images without noise.

```python
from pycocotools.coco import COCO

objects = COCO("annotations/instances_train.json")
```
"""
