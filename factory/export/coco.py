"""Images and their objects for detectors, in the format of COCO."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..dataset.pair_dataset import PairDataset
from ..labels import classes_of
from .notes import write_notes
from .objects import (
    MIN_OBJECT_PX,
    LabelledImage,
    VisibleObject,
    summarize_objects,
    write_labelled_images,
)


def write_coco(pairs: PairDataset, folder: Path) -> str:
    """images/SPLIT/KEY.png and annotations/instances_SPLIT.json, with boxes and masks.

    Categories have the numbers of the classes (`simnfnd.factory.labels`), from 1.  clean/SPLIT
    holds the ideal images.  Format: https://cocodataset.org/#format-data.
    Raises FactoryError for a dataset without labels.
    """
    object_count = 0
    small_count = 0
    for split in pairs.splits:
        annotations = _SplitAnnotations(pairs)
        for image in write_labelled_images(pairs, folder, split):
            annotations.add(image)
            object_count += len(image.objects)
            small_count += image.small_count
        write_annotations(annotations.document(split), folder, split)
    write_notes(pairs, folder, _NOTES)
    return summarize_objects(pairs, object_count, small_count)


class _SplitAnnotations:
    """The images and annotations of one split, filled image by image; ids count from 1."""

    def __init__(self, pairs: PairDataset) -> None:
        self._height, self._width = pairs.shape
        self._classes = classes_of(pairs.form.config)
        self._images: list[dict[str, Any]] = []
        self._annotations: list[dict[str, Any]] = []

    def add(self, image: LabelledImage) -> None:
        """Add an image and its objects."""
        image_id = len(self._images) + 1
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
            "id": len(self._annotations) + 1,
            "image_id": image_id,
            "category_id": shown.label,
            "bbox": shown.box,
            "area": shown.area_px,
            "segmentation": encode_run_lengths(shown.mask),
            "iscrowd": 0,
        }

    def document(self, split: str) -> dict[str, Any]:
        """The whole file of annotations."""
        return {
            "info": {"description": f"SimNFND, {split}; masks as run lengths", "version": "1.0"},
            "images": self._images,
            "annotations": self._annotations,
            "categories": list_categories(self._classes),
        }


def list_categories(classes: Sequence[str]) -> list[dict[str, Any]]:
    """The categories of COCO: every class but 0, the background."""
    return [
        {"id": label, "name": name, "supercategory": "object"}
        for label, name in enumerate(classes)
        if label
    ]


def write_annotations(document: dict[str, Any], folder: Path, split: str) -> None:
    """Write annotations/instances_SPLIT.json."""
    (folder / "annotations").mkdir(exist_ok=True)
    text = json.dumps(document, separators=(",", ":"))
    (folder / "annotations" / f"instances_{split}.json").write_text(text + "\n")


def encode_run_lengths(mask: npt.NDArray[np.bool_]) -> dict[str, list[int]]:
    """(H, W) as COCO's uncompressed runs: of 0, of 1, of 0, ... down each column in turn."""
    flat_mask = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat_mask, prepend=False))
    run_lengths = np.diff(changes, prepend=0, append=flat_mask.size)
    return {"counts": run_lengths.tolist(), "size": list(mask.shape)}


_NOTES = f"""\
`annotations/instances_SPLIT.json` holds, in the format of COCO, the objects in the images of
`images/SPLIT`: box, area in pixels, and the mask as run lengths, which pycocotools reads
(`annToMask`); `--to yolo` has polygons. Objects that show in fewer than {MIN_OBJECT_PX} pixels \
are left
out. `clean/SPLIT` has the same images without noise.

```python
from pycocotools.coco import COCO

objects = COCO("annotations/instances_train.json")
```
"""
