"""What a detector finds in images: the steps before and after its network, in NumPy.

Training, `simnfnd evaluate transfer` and `simnfnd detect` share them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...factory.common.array_types import Bools, Float32s, Int64s, UInt8s
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
    network_input,
    reaches_far_end,
    scale_image,
)
from .runtime import DetectorRuntime, RawOutputs

STRIDE = 4
"""Pixels of the image for each cell of the network's outputs."""
DIVISOR = 16
"""Sizes of images must divide by this."""
_SIDES_PX = (112, 160, 288)
"""Longer sides at which an image is looked at: objects come in more sizes than a dataset has."""
_USUAL_SIDE = 0.08  # of the longer side of the image: narrower detections count less
_CUT_OFF = 0.6  # weight of detections at the far end of the range
_MOST = 40  # detections in an image
_LEAST_SCORE = 0.01
_SAME_IOU = 0.45  # detections that overlap more are of one object
_BATCH = 8

Network = Callable[[Float32s], RawOutputs]


@dataclass(frozen=True, eq=False)
class Detections:
    """The detections in one image, best first.

    boxes: (N, 4) px of the original image.  scores: (N,) in 0..1.  labels: (N,) likeliest class.
    """

    boxes: Boxes
    scores: Float32s
    labels: Int64s

    def chosen(self, index: Bools | Int64s) -> Detections:
        """Some of them, by a mask or by their numbers."""
        return Detections(self.boxes[index], self.scores[index], self.labels[index])


def no_detections() -> Detections:
    """Detections of an image in which nothing was found."""
    return Detections(no_boxes(), np.zeros(0, np.float32), np.zeros(0, np.int64))


def detect_in(detector: DetectorRuntime, images: Sequence[UInt8s]) -> list[Detections]:
    """The objects in each grey image, in its own pixels; none lies mostly outside the fan.

    images: (H, W) uint8 each, 0 outside the fan.  Every image is looked at in three sizes, each as
    it is and mirrored.  Scores are probabilities where the detector was calibrated.
    """
    by_size = [detect_at(detector, images, side_px) for side_px in _SIDES_PX]
    return [
        _finish(detector, image, _fuse(views))
        for image, views in zip(images, zip(*by_size, strict=True), strict=True)
    ]


def _finish(detector: DetectorRuntime, image: UInt8s, fused: Detections) -> Detections:
    """Fused detections, weighed, calibrated, and without those outside the fan."""
    is_fan = find_fan(image)
    weighed = _weigh(fused, is_fan)
    margin_px = detector.facts.margin * max(image.shape)
    boxes = grow_boxes(weighed.boxes, margin_px, *image.shape)
    scores = weighed.scores
    if detector.facts.calibration is not None:
        scores = np.asarray(detector.facts.calibration(scores), np.float32)
    detections = Detections(boxes, scores, weighed.labels)
    return detections.chosen(_middles_inside(boxes, is_fan))


def _middles_inside(boxes: Boxes, is_fan: Bools) -> Bools:
    """(N,) bool: whether the middle of each box lies in the fan."""
    height, width = is_fan.shape
    column = np.clip((boxes[:, 0] + boxes[:, 2]) / 2, 0, width - 1).astype(int)
    row = np.clip((boxes[:, 1] + boxes[:, 3]) / 2, 0, height - 1).astype(int)
    return np.asarray(is_fan[row, column])


def detect_at(network: Network, images: Sequence[UInt8s], side_px: int) -> list[Detections]:
    """The objects in each image at one size; views and mirrored views are averaged."""
    detections: list[Detections] = []
    for start in range(0, len(images), _BATCH):
        unlabelled = [
            LabelledImage("", "", image, no_boxes(), np.zeros(0, np.int64))
            for image in images[start : start + _BATCH]
        ]
        batch = [scale_image(image, side_px) for image in unlabelled]
        shape = canvas_shape(batch, DIVISOR)
        inputs = np.stack([network_input(working, shape) for working in batch])
        outputs = _with_mirror(network, inputs)
        for number, working in enumerate(batch):
            one_image = RawOutputs(*(values[number] for values in outputs))
            detections.append(decode(one_image, working))
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


def _with_mirror(network: Network, inputs: Float32s) -> RawOutputs:
    """Probabilities of centres and classes, and sides, averaged over both views."""
    plain = network(inputs)
    mirrored = RawOutputs(*(values[..., ::-1] for values in network(inputs[..., ::-1].copy())))
    centre = (_sigmoid(plain.centre) + _sigmoid(mirrored.centre)) / 2
    # Left and right change places.
    sides = (plain.sides + mirrored.sides[:, [2, 1, 0, 3]]) / 2
    classes = (_softmax(plain.classes) + _softmax(mirrored.classes)) / 2
    return RawOutputs(centre, sides, classes)


def _sigmoid(logits: Float32s) -> Float32s:
    return np.asarray(1 / (1 + np.exp(-np.clip(logits, -80, 80))), np.float32)


def _softmax(logits: Float32s) -> Float32s:
    powers = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(powers / powers.sum(axis=1, keepdims=True), np.float32)


def decode(outputs: RawOutputs, working: WorkingImage) -> Detections:
    """The peaks of the heat map of one image, as boxes of the original image.

    outputs: of one image, (1, h, w), (4, h, w) and (K, h, w), probabilities instead of logits.
    """
    heat = outputs.centre[0]
    rows, columns = np.nonzero((_largest_around(heat) == heat) & (heat >= _LEAST_SCORE))
    order = np.argsort(-heat[rows, columns], kind="stable")[:_MOST]
    rows, columns = rows[order], columns[order]
    if not len(rows):
        return no_detections()
    x = columns + np.float32(0.5)
    y = rows + np.float32(0.5)
    left, up, right, down = outputs.sides[:, rows, columns]
    corners = np.stack([x - left, y - up, x + right, y + down], 1) * np.float32(STRIDE)
    boxes = clip_boxes(corners, *working.labelled.image.shape)
    scores = heat[rows, columns]
    labels = outputs.classes[:, rows, columns].argmax(axis=0)
    kept_numbers = suppress_duplicates(boxes, scores, _SAME_IOU)
    scaled = boxes[kept_numbers] / np.float32(working.scale)
    return Detections(scaled, scores[kept_numbers], labels[kept_numbers].astype(np.int64))


def _largest_around(heat: Float32s) -> Float32s:
    """(h, w): the largest of each cell and its eight neighbours."""
    padded = np.pad(heat, 1, constant_values=-1)
    windows = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
    return np.asarray(windows.max(axis=(2, 3)), np.float32)
