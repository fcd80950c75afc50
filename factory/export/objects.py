"""Exports of the objects in the pictures, for detectors: COCO and YOLO."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from ..dataset.pair_dataset import PairDataset
from ..dataset.schema import stored_image
from ..errors import FactoryError
from ..labels import classes_of
from .pictures import Sample, png, samples, write_notes

LEAST_PX = 8
"""An object that shows in fewer pixels is no larger than a speckle, and is left out."""

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Shown:
    """An object in a picture: its class, 1 or more, and the pixels (H, W) where it is seen."""

    label: int
    mask: Mask

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Left, top, width and height in pixels; the box holds the pixels wholly."""
        left, top, width, height = cv2.boundingRect(self.mask.astype(np.uint8))
        return left, top, width, height


def _pictures(
    pairs: PairDataset, to: str, folder: Path, take: Callable[[str, str, list[Shown]], None]
) -> str:
    """Write images/SPLIT/KEY.png and clean/ of every sample; returns one line that says so.

    take: is given split, key and objects of each.  Raises FactoryError for a dataset without
    labels.
    """
    if not {"segmentation", "instance"} <= set(pairs.layers):
        raise FactoryError(
            f"--to {to}: {pairs.folder} has no labels (/segmentation and /instance); make it from "
            "scenes with labels and dataset.layers=[segmentation], or export with --to png"
        )
    objects = left_out = 0
    for split in pairs.splits:
        for sample in samples(pairs, split):
            for name, layer in (("images", "noisy"), ("clean", "clean")):
                path = folder / name / split / f"{sample.key}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(png(stored_image(sample.images[layer], "uint8")))
            found = list(shown_in(sample, classes_of(pairs.form.config), pairs.folder))
            large = [shown for shown in found if int(shown.mask.sum()) >= LEAST_PX]
            objects += len(large)
            left_out += len(found) - len(large)
            take(split, sample.key, large)
    return f"{len(pairs)} pictures, {objects} objects; {left_out} below {LEAST_PX} pixels left out"


def shown_in(sample: Sample, classes: tuple[str, ...], directory: Path) -> Iterator[Shown]:
    """The pixels of each number in /instance, by the label that most of them have."""
    numbers, labels = sample.images["instance"], sample.images["segmentation"]
    for number in np.unique(numbers[numbers > 0]):
        mask = numbers == number
        label = int(np.bincount(labels[mask]).argmax())
        if label >= len(classes):
            raise FactoryError(
                f"{directory}: {sample.key}: /segmentation has a value {label}, "
                "which names no class"
            )
        if label:
            yield Shown(label, mask)


def write_coco(pairs: PairDataset, folder: Path) -> str:
    """images/SPLIT/NAME.png and annotations/instances_SPLIT.json, with boxes and masks.

    Categories have the numbers of the classes (`simnfnd.factory.labels`), from 1.  clean/SPLIT
    holds the ideal pictures.  Format: https://cocodataset.org/#format-data.
    Raises FactoryError for a dataset without labels.
    """
    height, width = pairs.shape
    (folder / "annotations").mkdir()
    documents: dict[str, dict[str, Any]] = {}
    for split in pairs.splits:
        documents[split] = {
            "info": {"description": f"SimNFND, {split}", "version": "1.0"},
            "images": [],
            "annotations": [],
            "categories": [
                {"id": label, "name": name, "supercategory": "object"}
                for label, name in enumerate(classes_of(pairs.form.config))
                if label
            ],
        }

    def take(split: str, key: str, found: list[Shown]) -> None:
        images, annotations = (documents[split][name] for name in ("images", "annotations"))
        size = {"width": width, "height": height}
        images.append({"id": len(images) + 1, "file_name": f"{key}.png", **size})
        for shown in found:
            one = {
                "id": len(annotations) + 1,
                "image_id": len(images),
                "category_id": shown.label,
                "bbox": shown.box,
                "area": int(shown.mask.sum()),
                "segmentation": run_lengths(shown.mask),
                "iscrowd": 0,
            }
            annotations.append(one)

    said = _pictures(pairs, "coco", folder, take)
    for split, document in documents.items():
        text = json.dumps(document, separators=(",", ":"))
        (folder / "annotations" / f"instances_{split}.json").write_text(text + "\n")
    write_notes(pairs, folder, _COCO_NOTES)
    return said


def run_lengths(mask: npt.NDArray[np.bool_]) -> dict[str, list[int]]:
    """(H, W) as COCO's uncompressed runs: of 0, of 1, of 0, ... down each column in turn."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat, prepend=False))
    counts = np.diff(changes, prepend=0, append=flat.size)
    return {"counts": counts.tolist(), "size": list(mask.shape)}


def write_yolo(pairs: PairDataset, folder: Path) -> str:
    """images/SPLIT/NAME.png, labels/SPLIT/NAME.txt and data.yaml, as Ultralytics reads them.

    A line of labels is a polygon: its class, then its corners as fractions of width and height;
    programs that detect take the box around it.  An object in parts that do not touch has a line
    for each part; holes, which the format does not know, are filled.  Format:
    https://docs.ultralytics.com/datasets/segment.
    Raises FactoryError for a dataset without labels.
    """
    splits = tuple(pairs.splits)
    for split in splits:
        (folder / "labels" / split).mkdir(parents=True)

    def take(split: str, key: str, found: list[Shown]) -> None:
        lines = []
        for shown in found:
            for ring in outlines(shown.mask):
                corners = (ring / shown.mask.shape[::-1]).ravel()
                places = " ".join(f"{value:.6f}" for value in corners)
                lines.append(f"{shown.label - 1} {places}\n")
        (folder / "labels" / split / f"{key}.txt").write_text("".join(lines))

    said = _pictures(pairs, "yolo", folder, take)
    # Without `path`, places are those beside data.yaml.  Both keys must be there.
    places = {
        key: f"images/{split if split in splits else splits[0]}"
        for key, split in (("train", "train"), ("val", "test"))
    }
    names = dict(enumerate(classes_of(pairs.form.config)[1:]))
    text = yaml.safe_dump({**places, "names": names}, sort_keys=False)
    (folder / "data.yaml").write_text(text)
    write_notes(pairs, folder, _YOLO_NOTES)
    return said


def outlines(mask: npt.NDArray[np.bool_]) -> list[npt.NDArray[np.int64]]:
    """(H, W) -> (corners, 2) columns and rows of each part whose pixels touch, also at corners.

    A pixel (column c, row r) covers c to c + 1 and r to r + 1, and rings run along these edges.
    """
    # Of pixels of twice the number, the outer ones say which side of their pixel lies outside.
    double = np.repeat(np.repeat(mask.astype(np.uint8), 2, axis=0), 2, axis=1)
    found, _ = cv2.findContours(double, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    rings = []
    for contour in found:
        ring = (contour[:, 0].astype(np.int64) + 1) // 2
        ring = ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)]
        # Of straight lines the ends alone.
        step = ring - np.roll(ring, 1, axis=0)
        rings.append(np.asarray(ring[np.any(step != np.roll(step, -1, axis=0), axis=1)]))
    return rings


_COCO_NOTES = f"""\
`annotations/instances_SPLIT.json` holds, in the format of COCO, the objects in the pictures of
`images/SPLIT`: box, area in pixels, and the mask as run lengths, which pycocotools reads
(`annToMask`). Objects that show in fewer than {LEAST_PX} pixels are left out. `clean/SPLIT`
has the same pictures without noise.

```python
from pycocotools.coco import COCO

objects = COCO("annotations/instances_train.json")
```
"""

_YOLO_NOTES = f"""\
`labels/SPLIT/NAME.txt` has a line for each object in `images/SPLIT/NAME.png`: its class (`names` of
`data.yaml`), then the corners of a polygon along the edges of its pixels, as fractions of width and
height. An object in parts that do not touch has a line for each part; holes are filled. Objects
that show in fewer than {LEAST_PX} pixels are left out. `data.yaml` takes the test split to
validate, or the only one that was exported. `clean/SPLIT` has the same pictures without
noise.

```sh
yolo segment train data=data.yaml   # or: yolo detect train
```
"""
