"""Objects that a detector found in a frame: class, probability, box, and where they are."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import UInt8s
from ...factory.dataset.fan_geometry import FanGeometry
from .boxes import Boxes
from .detector import Detections, detect_in
from .frames import ShownFrame
from .runtime import DetectorRuntime

THRESHOLD = 0.5
"""Probability from which on an object is shown, unless the caller says otherwise."""


class DetectedObject(NamedTuple):
    """An object that was found in an image.

    class_name: its likeliest class.  score: probability in 0..1 that there is an object.
    left, top, right, bottom: its box in pixels, right and bottom exclusive.
    slant_range_m, bearing_deg: of the middle of its box, bearing positive to the right.
    size_m: of the longer side of its box.  None where the geometry of the image is not known.
    """

    class_name: str
    score: float
    left: float
    top: float
    right: float
    bottom: float
    slant_range_m: float | None = None
    bearing_deg: float | None = None
    size_m: float | None = None


class Place(NamedTuple):
    """Where a point of an image is: None without metres."""

    slant_range_m: float | None
    bearing_deg: float


def place_of(geometry: FanGeometry, column: float, row: float) -> Place:
    """Range and bearing of a point; pixel edges lie at whole numbers."""
    if geometry.layout == "polar":
        step = row / geometry.range_bins
        fraction = geometry.near_fraction + (1 - geometry.near_fraction) * step
        numbers = np.arange(len(geometry.beam_azimuths_rad))
        azimuth_rad = float(np.interp(column - 0.5, numbers, geometry.beam_azimuths_rad))
    else:
        over = geometry.apex_y_px - (row - 0.5)
        right = (column - 0.5) - geometry.apex_x_px
        turned = ((over, right), (right, -over), (-over, -right), (-right, over))
        ahead, across = turned[geometry.quarter_turns % 4]
        across /= geometry.x_scale
        fraction = math.hypot(ahead, across) / geometry.far_px
        azimuth_rad = math.atan2(across, ahead)
    far_m = geometry.range_max_m
    range_m = None if far_m is None else fraction * far_m
    return Place(range_m, math.degrees(azimuth_rad))


def metres_per_pixel(geometry: FanGeometry | None) -> float | None:
    """Of a fan, along y; None where no range is known, and of polar images."""
    if geometry is None or geometry.layout == "polar" or geometry.range_max_m is None:
        return None
    return geometry.range_max_m / geometry.far_px


def find_objects(
    detector: DetectorRuntime,
    frames: Sequence[ShownFrame],
    *,
    threshold: float = THRESHOLD,
    classes: Collection[str] = (),
) -> list[list[DetectedObject]]:
    """What a detector finds in frames, best first.

    threshold: least score.  classes: those to return; none: all.
    """
    shown = [_far_range_on_top(frame) for frame in frames]
    names = detector.facts.classes
    results = []
    for frame, image, detections in zip(frames, shown, detect_in(detector, shown), strict=True):
        is_wanted = detections.scores >= threshold
        if classes:
            is_wanted &= np.isin(np.array(names)[detections.labels], list(classes))
        wanted = detections.chosen(is_wanted)
        turned = Detections(_turned_back(wanted.boxes, frame, image), wanted.scores, wanted.labels)
        results.append(_named(turned, names, frame.geometry))
    return results


def _far_range_on_top(frame: ShownFrame) -> UInt8s:
    """The image as a detector sees it: far range on top, black outside a known fan."""
    geometry = frame.geometry
    if geometry is None:
        return frame.image
    image = frame.image
    if geometry.layout == "fan":
        image = image * geometry.sector_mask(*image.shape)
    return np.ascontiguousarray(np.rot90(image, geometry.quarter_turns))


def _turned_back(boxes: Boxes, frame: ShownFrame, image: UInt8s) -> Boxes:
    """Boxes of an image that was turned to have far range on top, in the frame's own pixels."""
    turns = 0 if frame.geometry is None else frame.geometry.quarter_turns % 4
    height, width = image.shape
    for _ in range(turns):
        # A quarter turn clockwise.
        boxes = np.stack([height - boxes[:, 3], boxes[:, 0], height - boxes[:, 1], boxes[:, 2]], 1)
        height, width = width, height
    return boxes


def _named(
    detections: Detections, names: Sequence[str], geometry: FanGeometry | None
) -> list[DetectedObject]:
    objects = []
    scale_m = metres_per_pixel(geometry)
    rows = zip(
        detections.boxes.tolist(), detections.scores.tolist(), detections.labels, strict=True
    )
    for box, score, label in rows:
        left, top, right, bottom = box
        place = Place(None, math.nan)
        size_m = None
        if geometry is not None:
            place = place_of(geometry, (left + right) / 2, (top + bottom) / 2)
        if geometry is not None and scale_m is not None:
            size_m = scale_m * max((right - left) / geometry.x_scale, bottom - top)
        bearing_deg = place.bearing_deg if math.isfinite(place.bearing_deg) else None
        objects.append(
            DetectedObject(
                names[label],
                score,
                left,
                top,
                right,
                bottom,
                place.slant_range_m,
                bearing_deg,
                size_m,
            )
        )
    return objects
