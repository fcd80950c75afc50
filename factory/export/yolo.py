"""YOLO: images/SPLIT/NAME.png, labels/SPLIT/NAME.txt and data.yaml, as Ultralytics reads them.

A line of labels is a polygon: its class, then its corners as fractions of width and height;
programs that detect take the box around it.  An object in parts that do not touch has a line for
each part; holes, which the format does not know, are filled.  Format:
https://docs.ultralytics.com/datasets/segment.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from ..dataset.source import Source
from .objects import LEAST_PX, Objects, Shown
from .pictures import write_notes


def write(source: Source, folder: Path) -> str:
    """Fill `folder`.  Raises FactoryError for a dataset without labels."""
    objects = Objects(source, "yolo", folder)
    splits = tuple(source.splits)
    for split in splits:
        (folder / "labels" / split).mkdir(parents=True)
        for key, found in objects.of(split):
            lines = [line for shown in found for line in _lines(shown)]
            (folder / "labels" / split / f"{key}.txt").write_text("".join(lines))
    # Without `path`, places are those beside data.yaml.  Both keys must be there.
    places = {
        key: f"images/{split if split in splits else splits[0]}"
        for key, split in (("train", "train"), ("val", "test"))
    }
    names = dict(enumerate(objects.classes[1:]))
    text = yaml.safe_dump({**places, "names": names}, sort_keys=False)
    (folder / "data.yaml").write_text(text)
    write_notes(source, folder, _NOTES)
    return objects.summary()


def _lines(shown: Shown) -> list[str]:
    height, width = shown.mask.shape
    rings = [ring / (width, height) for ring in outlines(shown.mask)]
    return [
        f"{shown.label - 1} {' '.join(f'{value:.6f}' for value in ring.ravel())}\n"
        for ring in rings
    ]


def outlines(mask: npt.NDArray[np.bool_]) -> list[npt.NDArray[np.int64]]:
    """(H, W) -> (corners, 2) columns and rows of each part whose pixels touch, also at corners.

    A pixel (column c, row r) covers c to c + 1 and r to r + 1, and rings run along these edges.
    """
    # Of pixels of twice the number, the outer ones say which side of their pixel lies outside.
    double = np.repeat(np.repeat(mask.astype(np.uint8), 2, axis=0), 2, axis=1)
    found, _ = cv2.findContours(double, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [_corners((contour[:, 0].astype(np.int64) + 1) // 2) for contour in found]


def _corners(ring: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Of straight lines the ends alone."""
    ring = ring[np.any(ring != np.roll(ring, 1, axis=0), axis=1)]
    step = ring - np.roll(ring, 1, axis=0)
    return np.asarray(ring[np.any(step != np.roll(step, -1, axis=0), axis=1)])


_NOTES = f"""\
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
