"""Images and their objects for detectors, as Ultralytics reads them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import yaml

from ...common.array_types import Array, Bools, Int64s
from ...dataset.pair_dataset import PairDataset
from .notes import write_notes
from .object_selection import ClassList, ObjectSelection
from .objects import VisibleObject, survey_objects, write_labelled_images


def write_yolo(pairs: PairDataset, folder: Path, selection: ObjectSelection) -> str:
    """images/SPLIT/KEY.png, labels/SPLIT/KEY.txt and data.yaml.

    A line of labels is an object: its class, then the corners of one polygon as fractions of width
    and height; detectors use the box around it.  Parts of an object are joined by lines of no
    width; holes, which the format cannot express, are filled.  clean/SPLIT holds the clean images.
    Format: https://docs.ultralytics.com/datasets/segment.
    Raises FactoryError for a dataset without labels.
    """
    exported = survey_objects(pairs, selection)
    for split in pairs.splits:
        label_folder = folder / "labels" / split
        label_folder.mkdir(parents=True)
        for image in write_labelled_images(pairs, folder, split, exported):
            text = "".join(_label_line(shown, exported.classes) for shown in image.objects)
            (label_folder / f"{image.key}.txt").write_text(text)
    (folder / "data.yaml").write_text(_data_yaml(pairs, exported.classes))
    notes = f"{_NOTES}\n{exported.describe(first_number=0)}\n"
    write_notes(pairs, folder, notes, layers=("noisy", "clean"), has_records=False)
    return exported.summarize(len(pairs))


def _data_yaml(pairs: PairDataset, classes: ClassList) -> str:
    """Where the images of training and validation are, and the names of the classes from 0."""
    splits = tuple(pairs.splits)
    train_split = "train" if "train" in splits else splits[0]
    validation_split = "test" if "test" in splits else splits[0]
    # Without `path`, folders are relative to data.yaml.  Ultralytics requires both keys.
    document = {
        "train": f"images/{train_split}",
        "val": f"images/{validation_split}",
        "names": dict(enumerate(classes.names)),
    }
    return yaml.safe_dump(document, sort_keys=False)


def _label_line(shown: VisibleObject, classes: ClassList) -> str:
    """The line of an object; YOLO counts classes from 0."""
    height, width = shown.mask.shape
    polygon = join_outlines(trace_outlines(shown.mask))
    if not shown.is_echo_box:
        left, top, right, bottom = shown.box.corners
        polygon = np.array([[left, top], [right, top], [right, bottom], [left, bottom]])
    fractions = (polygon / (width, height)).ravel()
    corners = " ".join(f"{fraction:.6f}" for fraction in fractions)
    return f"{classes.number(shown.class_name) - 1} {corners}\n"


def join_outlines(outlines: list[Int64s]) -> Int64s:
    """One closed polygon (corners, 2) through the outlines (N, 2) of the parts of an object.

    The nearest part is added again and again: the polygon runs from its corner that is nearest to
    the part straight there, around the part, and the same way back.
    """
    polygon = outlines[0]
    remaining = list(outlines[1:])
    while remaining:
        bridges = [_shortest_bridge(polygon, part) for part in remaining]
        nearest = min(range(len(remaining)), key=lambda index: bridges[index][0])
        _, polygon_corner, part_corner = bridges[nearest]
        part = np.roll(remaining.pop(nearest), -part_corner, axis=0)
        detour = np.concatenate([part, part[:1], polygon[polygon_corner : polygon_corner + 1]])
        polygon = np.insert(polygon, polygon_corner + 1, detour, axis=0)
    return polygon


def _shortest_bridge(polygon: Int64s, part: Int64s) -> tuple[int, int, int]:
    """The squared distance of the nearest two corners, and the index of each."""
    steps = polygon[:, None] - part[None]
    squared_distances = (steps**2).sum(axis=-1)
    polygon_corner, part_corner = np.unravel_index(
        squared_distances.argmin(), squared_distances.shape
    )
    return int(squared_distances.min()), int(polygon_corner), int(part_corner)


def trace_outlines(mask: Bools) -> list[Int64s]:
    """Return the outline of each connected part of an (H, W) mask, (corners, 2) columns and rows.

    Pixels that touch at a corner are connected.  A pixel (column c, row r) covers c to c + 1 and
    r to r + 1, and outlines run along these edges.
    """
    # At twice the resolution, the outer pixels show which side of their pixel lies outside.
    double = np.repeat(np.repeat(mask.astype(np.uint8), 2, axis=0), 2, axis=1)
    contours, _ = cv2.findContours(double, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [_outline_corners(contour[:, 0]) for contour in contours]


def _outline_corners(contour: Array) -> Int64s:
    """The corners (N, 2) along pixel edges of a contour (M, 2) at twice the resolution."""
    vertices = (contour.astype(np.int64) + 1) // 2
    is_new = np.any(vertices != np.roll(vertices, 1, axis=0), axis=1)
    vertices = vertices[is_new]

    # A straight line keeps only its two ends.
    step = vertices - np.roll(vertices, 1, axis=0)
    is_corner = np.any(step != np.roll(step, -1, axis=0), axis=1)
    return np.asarray(vertices[is_corner])


_NOTES = """\
`labels/SPLIT/NAME.txt` has one line for each object in `images/SPLIT/NAME.png`: its class (`names`
of `data.yaml`), then the corners of a polygon along the edges of its pixels, as fractions of width
and height. Parts of an object that do not touch are joined by lines of no width; holes are filled.
`data.yaml` takes the test split to validate, or the only one that was exported. `clean/SPLIT` has
the same images without noise.

```sh
yolo segment train data=data.yaml   # or: yolo detect train
```
"""
