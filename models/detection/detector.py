"""What a trained detector finds in images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ...factory.common.array_types import Bools, Float32s, Int64s, UInt8s
from . import SHIPPED_NAME, find_detector
from .augmentation import place_unchanged
from .boxes import (
    Boxes,
    clip_boxes,
    grow_boxes,
    intersection_over_union,
    no_boxes,
    suppress_duplicates,
)
from .images import (
    LabelledImage,
    WorkingImage,
    canvas_shape,
    find_fan,
    reaches_far_end,
    scale_image,
)
from .network import DIVISOR, STRIDE, DetectorNetwork, Outputs
from .weights import TrainedDetector, load_detector

_SIDES_PX = (112, 160, 288)
"""Longer sides at which an image is looked at: objects come in more sizes than a dataset has."""
_USUAL_SIDE = 0.08  # of the longer side of the image: narrower detections count less
_CUT_OFF = 0.6  # weight of detections at the far end of the range
_MOST = 40  # detections in an image
_LEAST_SCORE = 0.01
_SAME_IOU = 0.45  # detections that overlap more are of one object
_BATCH = 8


@dataclass(frozen=True, eq=False)
class Detections:
    """The detections in one image, best first.

    boxes: (N, 4) px of the original image.  scores: (N,) in 0..1.  labels: (N,) likeliest class.
    """

    boxes: Boxes
    scores: Float32s
    labels: Int64s


class FoundObject(NamedTuple):
    """An object that was found: its likeliest class, a score in 0..1, and its box in pixels."""

    class_name: str
    score: float
    left: float
    top: float
    right: float
    bottom: float


def no_detections() -> Detections:
    """Detections of an image in which nothing was found."""
    return Detections(no_boxes(), np.zeros(0, np.float32), np.zeros(0, np.int64))


def find_objects(images: Sequence[UInt8s], detector: str = SHIPPED_NAME) -> list[list[FoundObject]]:
    """What a detector finds in grey images, best first.

    images: (H, W) uint8 each, 0 outside the fan.  detector: a file that `simnfnd evaluate transfer`
    wrote, or the name of the one that ships.  Raises FactoryError when there is no such detector.
    """
    trained = load_detector(find_detector(detector))
    unlabelled = [
        LabelledImage("", "", image, no_boxes(), np.zeros(0, np.int64)) for image in images
    ]
    return [
        [
            FoundObject(trained.classes[label], float(score), *map(float, box))
            for box, score, label in zip(
                detections.boxes, detections.scores, detections.labels, strict=True
            )
        ]
        for detections in detect(trained, unlabelled)
    ]


def detect(trained: TrainedDetector, images: Sequence[LabelledImage]) -> list[Detections]:
    """The objects in each image, in its own pixels.

    Every image is looked at in three sizes, each as it is and mirrored.
    """
    by_size = [_detect_at(trained.network, images, side_px) for side_px in _SIDES_PX]
    detections = []
    for image, views in zip(images, zip(*by_size, strict=True), strict=True):
        fused = _weigh(_fuse(views), find_fan(image.image))
        margin_px = trained.margin * max(image.image.shape)
        boxes = grow_boxes(fused.boxes, margin_px, *image.image.shape)
        detections.append(Detections(boxes, fused.scores, fused.labels))
    return detections


def _detect_at(
    network: DetectorNetwork, images: Sequence[LabelledImage], side_px: int
) -> list[Detections]:
    """The objects in each image at one size; views and mirrored views are averaged."""
    detections: list[Detections] = []
    for start in range(0, len(images), _BATCH):
        batch = [scale_image(image, side_px) for image in images[start : start + _BATCH]]
        shape = canvas_shape(batch, DIVISOR)
        inputs = np.stack([place_unchanged(working, shape)[0] for working in batch])
        outputs = _with_mirror(network, torch.from_numpy(inputs))
        for number, working in enumerate(batch):
            detections.append(_decode(outputs, number, working))
    return detections


def _fuse(views: Sequence[Detections]) -> Detections:
    """Merge detections that overlap: their mean box, weighted by the scores.

    Its score is the mean of the best one and of the mean over all views, so that an object that is
    found in one size alone counts, and one that is found in all of them counts more (after Solovyev
    et al. 2021, "Weighted boxes fusion").
    """
    boxes = np.concatenate([view.boxes for view in views])
    scores = np.concatenate([view.scores for view in views])
    labels = np.concatenate([view.labels for view in views])
    order = np.argsort(-scores, kind="stable")
    overlap = intersection_over_union(boxes, boxes)
    is_free = np.ones(len(boxes), bool)
    fused: list[tuple[Float32s, float, int]] = []
    for best in order:
        if not is_free[best]:
            continue
        is_member = (overlap[best] >= _SAME_IOU) & is_free
        is_member[best] = True  # also of a box without extent, which overlaps nothing
        is_free &= ~is_member
        weights = scores[is_member]
        box = np.average(boxes[is_member], axis=0, weights=weights)
        mean_score = min(1.0, float(weights.sum()) / len(views))
        fused.append((box, (float(scores[best]) + mean_score) / 2, int(labels[best])))
    fused.sort(key=lambda item: -item[1])
    if not fused:
        return no_detections()
    kept_boxes, kept_scores, kept_labels = zip(*fused[:_MOST], strict=True)
    return Detections(
        np.array(kept_boxes, np.float32),
        np.array(kept_scores, np.float32),
        np.array(kept_labels, np.int64),
    )


def _weigh(detections: Detections, is_fan: Bools) -> Detections:
    """The same detections, best first, with lower scores where people label few objects.

    These are narrow ones, and those that the far end of the range may cut off.
    """
    boxes = detections.boxes
    sides = (boxes[:, 2:] - boxes[:, :2]).min(axis=1, initial=np.inf)
    weights = np.minimum(sides / (_USUAL_SIDE * max(is_fan.shape)), 1)
    weights = np.where(reaches_far_end(boxes, is_fan), _CUT_OFF * weights, weights)
    scores = (detections.scores * weights).astype(np.float32)
    order = np.argsort(-scores, kind="stable")
    return Detections(boxes[order], scores[order], detections.labels[order])


def _with_mirror(network: DetectorNetwork, inputs: Tensor) -> Outputs:
    """Probabilities of centres and classes, and sides, averaged over both views."""
    with torch.inference_mode():
        plain = network(inputs.contiguous(memory_format=torch.channels_last))
        mirrored = network(inputs.flip(-1).contiguous(memory_format=torch.channels_last))
    centre = (plain.centre.sigmoid() + mirrored.centre.flip(-1).sigmoid()) / 2
    # Left and right change places.
    sides = (plain.sides + mirrored.sides.flip(-1)[:, [2, 1, 0, 3]]) / 2
    classes = (plain.classes.softmax(1) + mirrored.classes.flip(-1).softmax(1)) / 2
    return Outputs(centre, sides, classes)


def _decode(outputs: Outputs, number: int, working: WorkingImage) -> Detections:
    """The peaks of the heat map of one image, as boxes of the original image."""
    heat = outputs.centre[number : number + 1]
    is_peak = functional.max_pool2d(heat, 3, stride=1, padding=1) == heat
    scores, places = (heat * is_peak).flatten().topk(min(_MOST, heat.numel()))
    is_found = scores >= _LEAST_SCORE
    scores = scores[is_found]
    places = places[is_found]
    if not len(places):
        return no_detections()
    columns = heat.shape[-1]
    x = (places % columns).float() + 0.5
    y = (places // columns).float() + 0.5
    sides = outputs.sides[number].flatten(1)[:, places]
    corners = torch.stack([x - sides[0], y - sides[1], x + sides[2], y + sides[3]], 1)
    height, width = working.labelled.image.shape
    boxes = clip_boxes(np.asarray((corners * STRIDE).numpy(), np.float32), height, width)
    classes = outputs.classes[number].flatten(1)[:, places].argmax(0)
    values = np.asarray(scores.numpy(), np.float32)
    kept_numbers = suppress_duplicates(boxes, values, _SAME_IOU)
    original_boxes = boxes[kept_numbers] / np.float32(working.scale)
    return Detections(
        original_boxes, values[kept_numbers], np.asarray(classes.numpy(), np.int64)[kept_numbers]
    )
