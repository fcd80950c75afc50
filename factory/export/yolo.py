"""Images and their objects for detectors, as Ultralytics reads them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from ..dataset.pair_dataset import PairDataset
from ..labels import classes_of
from .notes import write_notes
from .objects import MIN_OBJECT_PX, VisibleObject, summarize_objects, write_labelled_images


def write_yolo(pairs: PairDataset, folder: Path) -> str:
    """images/SPLIT/KEY.png, labels/SPLIT/KEY.txt and data.yaml.

    A line of labels is a polygon: its class, then its corners as fractions of width and height;
    detectors use the box around it.  An object in separate parts has a line for each part; holes,
    which the format cannot express, are filled.  clean/SPLIT holds the ideal images.  Format:
    https://docs.ultralytics.com/datasets/segment.
    Raises FactoryError for a dataset without labels.
    """
    object_count = 0
    small_count = 0
    for split in pairs.splits:
        label_folder = folder / "labels" / split
        label_folder.mkdir(parents=True)
        for image in write_labelled_images(pairs, folder, split):
            text = "".join(_label_lines(shown) for shown in image.objects)
            (label_folder / f"{image.key}.txt").write_text(text)
            object_count += len(image.objects)
            small_count += image.small_count
    (folder / "data.yaml").write_text(_data_yaml(pairs))
    write_notes(pairs, folder, _NOTES)
    return summarize_objects(pairs, object_count, small_count)


def _data_yaml(pairs: PairDataset) -> str:
    """Where the images of training and validation are, and the names of the classes from 0."""
    splits = tuple(pairs.splits)
    train_split = "train" if "train" in splits else splits[0]
    validation_split = "test" if "test" in splits else splits[0]
    # Without `path`, folders are relative to data.yaml.  Ultralytics requires both keys.
    document = {
        "train": f"images/{train_split}",
        "val": f"images/{validation_split}",
        "names": dict(enumerate(classes_of(pairs.form.config)[1:])),
    }
    return yaml.safe_dump(document, sort_keys=False)


def _label_lines(shown: VisibleObject) -> str:
    """A line for each part of an object; YOLO counts classes from 0."""
    height, width = shown.mask.shape
    lines = []
    for outline in trace_outlines(shown.mask):
        fractions = (outline / (width, height)).ravel()
        corners = " ".join(f"{fraction:.6f}" for fraction in fractions)
        lines.append(f"{shown.label - 1} {corners}\n")
    return "".join(lines)


def trace_outlines(mask: npt.NDArray[np.bool_]) -> list[npt.NDArray[np.int64]]:
    """Return the outline of each connected part of an (H, W) mask, (corners, 2) columns and rows.

    Pixels that touch at a corner are connected.  A pixel (column c, row r) covers c to c + 1 and
    r to r + 1, and outlines run along these edges.
    """
    # At twice the resolution, the outer pixels show which side of their pixel lies outside.
    double = np.repeat(np.repeat(mask.astype(np.uint8), 2, axis=0), 2, axis=1)
    contours, _ = cv2.findContours(double, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [_outline_corners(contour[:, 0]) for contour in contours]


def _outline_corners(contour: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """The corners (N, 2) along pixel edges of a contour (M, 2) at twice the resolution."""
    vertices = (contour.astype(np.int64) + 1) // 2
    is_new = np.any(vertices != np.roll(vertices, 1, axis=0), axis=1)
    vertices = vertices[is_new]

    # A straight line keeps only its two ends.
    step = vertices - np.roll(vertices, 1, axis=0)
    is_corner = np.any(step != np.roll(step, -1, axis=0), axis=1)
    return np.asarray(vertices[is_corner])


_NOTES = f"""\
`labels/SPLIT/NAME.txt` has a line for each object in `images/SPLIT/NAME.png`: its class (`names` of
`data.yaml`), then the corners of a polygon along the edges of its pixels, as fractions of width and
height. An object in parts that do not touch has a line for each part; holes are filled. Objects
that show in fewer than {MIN_OBJECT_PX} pixels are left out. `data.yaml` takes the test split to
validate, or the only one that was exported. `clean/SPLIT` has the same images without
noise.

```sh
yolo segment train data=data.yaml   # or: yolo detect train
```
"""
