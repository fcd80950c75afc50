"""COCO: images/SPLIT/NAME.png and annotations/instances_SPLIT.json, with boxes and masks.

Categories have the numbers of the classes (`simnfnd.factory.labels`), from 1.  clean/SPLIT holds
the ideal pictures.  Format: https://cocodataset.org/#format-data.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ..dataset.source import Source
from .objects import LEAST_PX, Objects, Shown
from .pictures import write_notes


def write(source: Source, folder: Path) -> str:
    """Fill `folder`.  Raises FactoryError for a dataset without labels."""
    objects = Objects(source, "coco", folder)
    height, width = source.shape
    (folder / "annotations").mkdir()
    categories = [
        {"id": label, "name": name, "supercategory": "object"}
        for label, name in enumerate(objects.classes)
        if label
    ]
    for split in source.splits:
        images: list[dict[str, Any]] = []
        annotations: list[dict[str, Any]] = []
        for key, found in objects.of(split):
            number = len(images) + 1
            size = {"width": width, "height": height}
            images.append({"id": number, "file_name": f"{key}.png", **size})
            for shown in found:
                annotations.append(_annotation(shown, len(annotations) + 1, number))
        document = {
            "info": {"description": f"SimNFND, {split}", "version": "1.0"},
            "images": images,
            "annotations": annotations,
            "categories": categories,
        }
        text = json.dumps(document, separators=(",", ":"))
        (folder / "annotations" / f"instances_{split}.json").write_text(text + "\n")
    write_notes(source, folder, _NOTES)
    return objects.summary()


def _annotation(shown: Shown, number: int, image: int) -> dict[str, Any]:
    return {
        "id": number,
        "image_id": image,
        "category_id": shown.label,
        "bbox": shown.box,
        "area": int(shown.mask.sum()),
        "segmentation": run_lengths(shown.mask),
        "iscrowd": 0,
    }


def run_lengths(mask: npt.NDArray[np.bool_]) -> dict[str, list[int]]:
    """(H, W) as COCO's uncompressed runs: of 0, of 1, of 0, ... down each column in turn."""
    flat = mask.ravel(order="F")
    changes = np.flatnonzero(np.diff(flat, prepend=False))
    counts = np.diff(changes, prepend=0, append=flat.size)
    return {"counts": counts.tolist(), "size": list(mask.shape)}


_NOTES = f"""\
`annotations/instances_SPLIT.json` holds, in the format of COCO, the objects in the pictures of
`images/SPLIT`: box, area in pixels, and the mask as run lengths, which pycocotools reads
(`annToMask`). Objects that show in fewer than {LEAST_PX} pixels are left out. `clean/SPLIT`
has the same pictures without noise.

```python
from pycocotools.coco import COCO

objects = COCO("annotations/instances_train.json")
```
"""
