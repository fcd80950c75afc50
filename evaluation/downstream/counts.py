"""What a network says of a picture, as counts of which any draw of pictures can be put together."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .boxes import boxes_of, hits, scored_boxes
from .pictures import WALL

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Counts:
    """Of one picture.

    hit, truth, found: pixels by class: rightly found, there, found.  objects: the same three of
    any object against ground, pixels of walls left out.
    boxes: class -> (score, hit) of each box found; 0 stands for objects of any class.
    there: how many boxes are there, by class, any object first.
    """

    hit: list[int]
    truth: list[int]
    found: list[int]
    objects: list[int]
    boxes: dict[int, list[tuple[float, bool]]]
    there: list[int]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> Counts:
        """The counterpart; ValueError, KeyError or TypeError for what it cannot be."""
        boxes = {
            int(one): [(float(score), bool(hit)) for score, hit in found]
            for one, found in values["boxes"].items()
        }
        return cls(**{**values, "boxes": boxes})


def counts_of(likely: npt.NDArray[np.float32], truth: Indices) -> Counts:
    """likely: (classes, H, W) probability of each class.  truth: (H, W) class indices.

    An object is where all classes but ground and walls are likelier than these.
    """
    classes = len(likely)
    found = likely.argmax(axis=0)
    kinds = [one for one in range(1, classes) if one != WALL]
    chance = np.asarray(likely[kinds].sum(axis=0), np.float32)
    walls = truth == WALL
    object_found, object_there = chance > 0.5, (truth > 0) & ~walls
    boxes: dict[int, list[tuple[float, bool]]] = {}
    there = []
    for one in range(classes):
        if one == 0:
            mask, score, real = object_found & ~walls, chance, object_there
        else:
            mask, score, real = found == one, likely[one], truth == one
        scored, real_boxes = scored_boxes(mask, score), boxes_of(real)
        there.append(len(real_boxes))
        if scored:
            right = hits(scored, real_boxes)
            boxes[one] = [(round(s, 6), hit) for (s, _), hit in zip(scored, right, strict=True)]
    both = found[found == truth]
    counted = [object_found & object_there, object_there, object_found & ~walls]
    return Counts(
        np.bincount(both, minlength=classes).tolist(),
        np.bincount(truth.ravel(), minlength=classes).tolist(),
        np.bincount(found.ravel(), minlength=classes).tolist(),
        [int(mask.sum()) for mask in counted],
        boxes,
        there,
    )
