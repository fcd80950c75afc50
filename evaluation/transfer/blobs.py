"""A detector that learns nothing: connected areas that are brighter than what is around them."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ...factory.common.array_types import Float32s
from ...models.detection.boxes import clip_boxes, suppress_duplicates
from ...models.detection.detector import Detections, no_detections
from ...models.detection.images import WorkingImage, network_input

_SMOOTH_PX = 1.5
_THRESHOLDS = (1.5, 2.2, 3.0)  # standard deviations of the smoothed image
_CLOSING_PX = 5
_SIDES_PX = (6, 60)  # least and greatest longer side of an area
_MARGIN_PX = 2.5
_MOST = 20
_SAME_IOU = 0.3


def detect_blobs(images: Sequence[WorkingImage]) -> list[Detections]:
    """Bright areas of each image at three thresholds, the brightest and largest first.

    All lengths are pixels at the size of the detector, whose input this takes, too: gain and trend
    over range are removed.
    """
    return [_detect_in(working) for working in images]


def _detect_in(working: WorkingImage) -> Detections:
    height, width = working.labelled.image.shape
    shape = (height, width)
    inputs = network_input(working, shape)
    smooth = _smoothed(inputs[0], inputs[2])
    candidates = [
        candidate for threshold in _THRESHOLDS for candidate in _areas_above(smooth, threshold)
    ]
    if not candidates:
        return no_detections()
    boxes = clip_boxes(np.array([box for box, _ in candidates], np.float32), *shape)
    scores = np.array([score for _, score in candidates], np.float32)
    kept_numbers = suppress_duplicates(boxes, scores, _SAME_IOU)[:_MOST]
    labels = np.zeros(len(kept_numbers), np.int64)
    return Detections(boxes[kept_numbers] / np.float32(working.scale), scores[kept_numbers], labels)


def _smoothed(grey: Float32s, fan: Float32s) -> Float32s:
    """The blurred image in units of its standard deviation; 0 outside the fan."""
    weight = cv2.GaussianBlur(fan, (0, 0), _SMOOTH_PX) + 1e-3
    smooth = cv2.GaussianBlur(grey * fan, (0, 0), _SMOOTH_PX) / weight * fan
    inside = smooth[fan > 0]
    return np.asarray(smooth / (inside.std() + 1e-6) if inside.size else smooth, np.float32)


def _areas_above(smooth: Float32s, threshold: float) -> list[tuple[list[float], float]]:
    """Box and score of each connected area above a threshold.

    The score is the mean brightness times the square root of the side of a square of that size.
    """
    element = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_CLOSING_PX, _CLOSING_PX))
    bright = cv2.morphologyEx((smooth > threshold).astype(np.uint8), cv2.MORPH_CLOSE, element)
    count, area_of, statistics, _ = cv2.connectedComponentsWithStats(bright)
    candidates = []
    for number in range(1, count):
        left, top, width, height, _ = (int(value) for value in statistics[number])
        if not _SIDES_PX[0] <= max(width, height) <= _SIDES_PX[1]:
            continue
        place = np.s_[top : top + height, left : left + width]
        brightness = float(smooth[place][area_of[place] == number].mean())
        box = [
            left - _MARGIN_PX,
            top - _MARGIN_PX,
            left + width + _MARGIN_PX,
            top + height + _MARGIN_PX,
        ]
        candidates.append((box, brightness * (width * height) ** 0.25))
    return candidates
