"""YOLO: images/SPLIT/NAME.png, labels/SPLIT/NAME.txt and data.yaml, as Ultralytics reads them.

A line of labels is one object: its class, then the corners of one polygon as fractions of width
and height; programs that detect take the box around it.  Format:
https://docs.ultralytics.com/datasets/segment.
"""

from __future__ import annotations

from pathlib import Path

import yaml

from ..dataset.read.source import Source
from .objects import (
    LEAST_PX,
    Labelled,
    LabelledSet,
    Shown,
    labelled_dataset,
    summary,
    write_pictures,
)
from .outlines import joined, outlines


def write(source: Source, folder: Path) -> str:
    """Fill `folder`.  Raises FactoryError for a dataset without labels."""
    return write_labelled(labelled_dataset(source, "yolo"), folder)


def write_labelled(pictures: LabelledSet, folder: Path) -> str:
    """Fill `folder` with all pictures and their objects."""
    images = objects = left_out = 0
    for split in pictures.splits:
        (folder / "labels" / split).mkdir(parents=True)
        for one in pictures.pictures(split):
            write_pictures(one, split, folder)
            lines = [_line(one, shown) for shown in one.objects]
            (folder / "labels" / split / f"{one.key}.txt").write_text("".join(lines))
            images += 1
            objects += len(lines)
            left_out += one.left_out
    # Without `path`, places are those beside data.yaml.  Both keys must be there.
    only = pictures.splits[0]
    places = {
        key: f"images/{split if split in pictures.splits else only}"
        for key, split in (("train", "train"), ("val", "test"))
    }
    names = dict(enumerate(pictures.classes[1:]))
    text = yaml.safe_dump({**places, "names": names}, sort_keys=False)
    (folder / "data.yaml").write_text(text)
    pictures.note(folder, _NOTES)
    return summary(images, objects, left_out)


def _line(one: Labelled, shown: Shown) -> str:
    height, width = one.noisy.shape
    corners = joined(outlines(shown.mask)) / (width, height)
    return f"{shown.label - 1} {' '.join(f'{value:.6f}' for value in corners.ravel())}\n"


_NOTES = f"""\
`labels/SPLIT/NAME.txt` has a line for each object in `images/SPLIT/NAME.png`: its class (`names` of
`data.yaml`), then the corners of a polygon along the edges of its pixels, as fractions of width and
height. Parts and holes of an object are joined by slits, as a line holds one polygon. Objects that
show in fewer than {LEAST_PX} pixels are left out. `data.yaml` takes the test split to validate, or
the only one that was exported. `clean/SPLIT`, if there, has the same pictures without noise.

```sh
yolo segment train data=data.yaml   # or: yolo detect train
```
"""
