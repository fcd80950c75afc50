"""Boxes of the patches of a mask, and which of them hit what is really there."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

Mask = npt.NDArray[np.bool_]
Box = tuple[int, int, int, int]
"""Left, top, right, bottom; right and bottom are the first pixels beyond."""

LEAST_PX = 4
"""Smaller patches are no objects, in what is there as in what is found."""
OVERLAP = 0.5


def boxes_of(mask: Mask) -> list[Box]:
    """The boxes around the connected patches (diagonals connect) of (H, W)."""
    return [box for box, _ in _patches(mask)]


def scored_boxes(mask: Mask, score: npt.NDArray[np.float32]) -> list[tuple[float, Box]]:
    """The same with the mean of (H, W) `score` in each patch, the highest first."""
    found = [(float(score[patch].mean()), box) for box, patch in _patches(mask)]
    return sorted(found, key=lambda one: (-one[0], one[1]))


def hits(found: Sequence[tuple[float, Box]], there: Sequence[Box]) -> list[bool]:
    """Whether each box, the highest score first, overlaps one that is there and not yet taken.

    It takes the one that it overlaps most; by half of what both cover together at least.
    """
    left = list(there)
    result = []
    for _, box in found:
        shares = [overlap(box, one) for one in left]
        best = int(np.argmax(shares)) if shares else -1
        hit = best >= 0 and shares[best] >= OVERLAP
        if hit:
            left.pop(best)
        result.append(hit)
    return result


def overlap(first: Box, second: Box) -> float:
    """Intersection over union."""
    width = min(first[2], second[2]) - max(first[0], second[0])
    height = min(first[3], second[3]) - max(first[1], second[1])
    if width <= 0 or height <= 0:
        return 0.0
    return width * height / (_area(first) + _area(second) - width * height)


def _area(box: Box) -> int:
    return (box[2] - box[0]) * (box[3] - box[1])


def _patches(mask: Mask) -> list[tuple[Box, Mask]]:
    count, numbers, table, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    found = []
    for one in range(1, count):
        x, y, width, height, area = (int(value) for value in table[one])
        if area >= LEAST_PX:
            found.append(((x, y, x + width, y + height), np.asarray(numbers == one)))
    return found
