"""Images with labelled objects, at the size at which the detector works."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Float32s, Int64s, UInt8s
from .boxes import Boxes
from .normalise import normalise

SIDE_PX = 160
"""The longer side of an image that the detector learns from."""

_END_SHARE = 0.0125  # what comes so near to the far end, as a share of the longer side, is cut off

UNKNOWN = -1
"""Label of an object whose class the detector does not know."""


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """A grey image and its objects.

    image: (H, W) uint8, 0 outside the fan.  boxes: (N, 4) px.  labels: (N,) number of the class of
    each object, or UNKNOWN.  group: images of one group show nearly the same scene.
    """

    name: str
    group: str
    image: UInt8s
    boxes: Boxes
    labels: Int64s


@dataclass(frozen=True, eq=False)
class WorkingImage:
    """A labelled image at the size at which a network sees it.

    scale: pixels here for each pixel of the original.  is_fan: (H, W) bool, the insonified sector.
    """

    labelled: LabelledImage
    scale: float
    is_fan: Bools


def scale_image(source: LabelledImage, side_px: int = SIDE_PX) -> WorkingImage:
    """The image with `side_px` pixels on its longer side, with its boxes and its fan."""
    height, width = source.image.shape
    scale = side_px / max(height, width)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    image = np.asarray(cv2.resize(source.image, size, interpolation=interpolation), np.uint8)
    scaled = LabelledImage(
        source.name,
        source.group,
        image,
        np.asarray(source.boxes * scale, np.float32).reshape(-1, 4),
        source.labels,
    )
    return WorkingImage(scaled, scale, find_fan(image))


def find_fan(image: UInt8s) -> Bools:
    """(H, W) bool: the convex hull of all pixels that are not black.

    Bearings without an echo are black but belong to the fan; a sonar shows its noise there.
    """
    filled = np.zeros(image.shape, np.uint8)
    lit = cv2.findNonZero((image > 2).astype(np.uint8))
    if lit is not None:
        cv2.fillConvexPoly(filled, cv2.convexHull(lit), (1,))
    return filled > 0


def reaches_far_end(boxes: Boxes, is_fan: Bools) -> Bools:
    """(N,) bool: whether the end of the range window may cut off what is in each box.

    boxes: (N, 4) px.  is_fan: (H, W) bool; ranges grow towards the top.
    """
    height, width = is_fan.shape
    rows = np.rint(boxes[:, 1] - _END_SHARE * max(height, width)).astype(int)
    middles = ((boxes[:, 0] + boxes[:, 2]) / 2).astype(int)
    inside = is_fan[np.clip(rows, 0, height - 1), np.clip(middles, 0, width - 1)]
    return np.asarray((rows < 0) | ~inside)


def canvas_shape(images: Sequence[WorkingImage], stride: int) -> tuple[int, int]:
    """Height and width that hold every image, and divide by the stride of the network."""
    shapes = [working.labelled.image.shape for working in images]
    height = max(shape[0] for shape in shapes)
    width = max(shape[1] for shape in shapes)
    return -(-height // stride) * stride, -(-width // stride) * stride


def network_input(working: WorkingImage, shape: tuple[int, int]) -> Float32s:
    """Network input (3, H, W) of an image in the upper left corner of a canvas of this shape."""
    image = np.zeros(shape, np.float32)
    is_fan = np.zeros(shape, bool)
    height, width = working.labelled.image.shape
    image[:height, :width] = working.labelled.image / np.float32(255)
    is_fan[:height, :width] = working.is_fan
    return normalise(image, is_fan)
