"""Arithmetic on boxes: (N, 4) float32 of left, top, right, bottom in pixels."""

from __future__ import annotations

import numpy as np

from ...factory.common.array_types import Float32s

Boxes = Float32s
"""(N, 4): left, top, right, bottom, pixels."""


def no_boxes() -> Boxes:
    """An empty array of boxes."""
    return np.zeros((0, 4), np.float32)


def areas(boxes: Boxes) -> Float32s:
    """(N,) areas in px²; 0 for a box without extent."""
    sides = np.maximum(boxes[:, 2:] - boxes[:, :2], 0)
    return np.asarray(sides[:, 0] * sides[:, 1], np.float32)


def overlaps(first: Boxes, second: Boxes) -> Float32s:
    """(N, M) px²: the area that each box of the first shares with each of the second."""
    low = np.maximum(first[:, None, :2], second[None, :, :2])
    high = np.minimum(first[:, None, 2:], second[None, :, 2:])
    sides = np.maximum(high - low, 0)
    return np.asarray(sides[..., 0] * sides[..., 1], np.float32)


def intersection_over_union(first: Boxes, second: Boxes) -> Float32s:
    """(N, M) area that two boxes share over the area that they cover together, 0..1."""
    shared = overlaps(first, second)
    union = areas(first)[:, None] + areas(second)[None] - shared
    return np.asarray(shared / np.maximum(union, 1e-6), np.float32)


def share_inside(inner: Boxes, outer: Boxes) -> Float32s:
    """(N, M) in 0..1: which part of each first box lies inside each second one."""
    return np.asarray(overlaps(inner, outer) / np.maximum(areas(inner), 1e-6)[:, None], np.float32)


def clip_boxes(boxes: Boxes, height: int, width: int) -> Boxes:
    """The part of each box inside an image; it may be empty."""
    limits = np.array([width, height, width, height], np.float32)
    return np.asarray(np.clip(boxes, 0, limits), np.float32)


def grow_boxes(boxes: Boxes, margin_px: float, height: int, width: int) -> Boxes:
    """Every side moved outwards by a margin, as far as the edge of the image."""
    grown = boxes + margin_px * np.array([-1, -1, 1, 1], np.float32)
    return clip_boxes(grown, height, width)


def mirror_boxes(boxes: Boxes, width: int) -> Boxes:
    """Boxes of the image with left and right swapped."""
    mirrored = boxes[:, [2, 1, 0, 3]]
    mirrored[:, [0, 2]] = width - mirrored[:, [0, 2]]
    return mirrored


def suppress_duplicates(boxes: Boxes, scores: Float32s, iou: float) -> list[int]:
    """Numbers of the boxes to keep, best first: none overlaps a better one by more than `iou`."""
    overlap = intersection_over_union(boxes, boxes)
    kept_numbers: list[int] = []
    for number in np.argsort(-scores, kind="stable").tolist():
        if all(overlap[number, better] <= iou for better in kept_numbers):
            kept_numbers.append(number)
    return kept_numbers
