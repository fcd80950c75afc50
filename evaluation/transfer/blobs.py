"""A detector that learns nothing: bright places of about the size of an object."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from scipy.ndimage import maximum_filter

from ...models.detection.augmentation import place_unchanged
from ...models.detection.boxes import clip_boxes, suppress_duplicates
from ...models.detection.detector import Detections, no_detections
from ...models.detection.images import WorkingImage

_SCALES_PX = (5.0, 7.0, 10.0, 14.0, 20.0)  # standard deviations, at the detector's size
_HALF_SIDE = 1.6  # of a box, in standard deviations
_MOST = 20
_SAME_IOU = 0.3


def detect_blobs(images: Sequence[WorkingImage]) -> list[Detections]:
    """Peaks of the difference of Gaussians of each image at five scales; scores are in 0..1.

    Lindeberg, "Feature detection with automatic scale selection", IJCV 30 (1998).
    """
    return [_detect_in(working) for working in images]


def _detect_in(working: WorkingImage) -> Detections:
    inputs, _, _ = place_unchanged(working, working.labelled.image.shape)
    grey, _, fan = inputs
    responses = np.stack([_difference(grey, fan, scale) for scale in _SCALES_PX])
    is_peak = (maximum_filter(responses, (3, 9, 9)) == responses) & (responses > 0)
    level, y, x = np.nonzero(is_peak)
    strength = responses[level, y, x]
    strongest = np.argsort(-strength, kind="stable")[:_MOST]
    if not strongest.size:
        return no_detections()
    half = _HALF_SIDE * np.array(_SCALES_PX, np.float32)[level[strongest]]
    centre = np.stack([x[strongest], y[strongest]], 1).astype(np.float32) + 0.5
    corners = np.concatenate([centre - half[:, None], centre + half[:, None]], 1)
    boxes = clip_boxes(corners, *working.labelled.image.shape)
    scores = np.clip(strength[strongest], 0, 1).astype(np.float32)
    kept = suppress_duplicates(boxes, scores, _SAME_IOU)
    labels = np.zeros(len(kept), np.int64)
    return Detections(boxes[kept] / np.float32(working.scale), scores[kept], labels)


def _difference(grey: np.ndarray, fan: np.ndarray, scale_px: float) -> np.ndarray:
    """Mean of a neighbourhood minus that of a wider one, both of pixels of the fan, (H, W)."""
    means = []
    for sigma in (scale_px, 1.6 * scale_px):
        weight = cv2.GaussianBlur(fan, (0, 0), sigma) + 1e-3
        means.append(cv2.GaussianBlur(grey * fan, (0, 0), sigma) / weight)
    return np.asarray((means[0] - means[1]) * fan, np.float32)
