"""A sheet of real images with what a detector found, missed and took for an object."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ...factory.common.array_types import UInt8s
from ...models.detection.boxes import Boxes, intersection_over_union
from ...models.detection.detector import Detections
from .coco import RealImage
from .scores import IOU_STRICT

HIT = (90, 200, 60)
MISS = (60, 60, 240)
FALSE_ALARM = (40, 200, 255)
IGNORED = (150, 110, 110)
"""Colours of boxes, BGR."""

_COLUMNS = 5
_TILE_PX = 480  # longer side of an image on the sheet
_GAP_PX = 6
_TEXT = (235, 235, 235)
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def detection_sheet(
    images: Sequence[RealImage], detections: Sequence[Detections], threshold: float, most: int
) -> bytes:
    """A PNG of at most this many images, one of each group first.

    Green: an object that was found; red: one that was missed; yellow: a false alarm; grey: a box of
    an ignored class.  Detections below the threshold are left out.
    """
    numbers = _choose(images, most)
    tiles = [_draw_tile(images[number], detections[number], threshold) for number in numbers]
    height = max(tile.shape[0] for tile in tiles)
    width = max(tile.shape[1] for tile in tiles)
    rows = -(-len(tiles) // _COLUMNS)
    columns = min(_COLUMNS, len(tiles))
    shape = (rows * (height + _GAP_PX) + _GAP_PX, columns * (width + _GAP_PX) + _GAP_PX, 3)
    sheet: UInt8s = np.full(shape, 24, np.uint8)
    for place, tile in enumerate(tiles):
        row, column = divmod(place, _COLUMNS)
        top = _GAP_PX + row * (height + _GAP_PX)
        left = _GAP_PX + column * (width + _GAP_PX)
        sheet[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    _, content = cv2.imencode(".png", sheet)
    return content.tobytes()


def _choose(images: Sequence[RealImage], most: int) -> list[int]:
    """Numbers of images, evenly spread over those that come first in their groups."""
    order: dict[tuple[int, int], int] = {}
    rank_in_group: dict[str, int] = {}
    for number, image in enumerate(images):
        group = image.labelled.group
        rank_in_group[group] = rank_in_group.get(group, -1) + 1
        order[rank_in_group[group], number] = number
    firsts = [order[key] for key in sorted(order) if key[0] == 0]
    if len(firsts) < most:
        return [order[key] for key in sorted(order)][:most]
    return [firsts[int(place * len(firsts) / most)] for place in range(most)]


def _draw_tile(image: RealImage, detections: Detections, threshold: float) -> UInt8s:
    """One image, enlarged, with its boxes."""
    grey = image.labelled.image
    scale = _TILE_PX / max(grey.shape)
    size = (round(grey.shape[1] * scale), round(grey.shape[0] * scale))
    enlarged = cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR)
    tile = np.asarray(cv2.cvtColor(enlarged, cv2.COLOR_GRAY2BGR), np.uint8)
    shown = detections.boxes[detections.scores >= threshold]
    truth = image.labelled.boxes
    pairs = match_greedily(shown, truth)
    hits = [number for number, _ in pairs]
    matched = [number for _, number in pairs]
    _draw(tile, image.ignored, scale, IGNORED)
    _draw(tile, np.delete(truth, matched, axis=0), scale, MISS)
    _draw(tile, np.delete(shown, hits, axis=0), scale, FALSE_ALARM)
    _draw(tile, shown[hits], scale, HIT)
    caption = f"group {image.labelled.group}" if image.labelled.group.isdigit() else ""
    cv2.putText(tile, caption, (4, size[1] - 6), _FONT, 0.4, _TEXT, 1, cv2.LINE_AA)
    return tile


def match_greedily(shown: Boxes, truth: Boxes) -> list[tuple[int, int]]:
    """(detection, object) of every hit; better detections, which come first, choose first."""
    pairs: list[tuple[int, int]] = []
    if not len(truth):
        return pairs
    overlap = intersection_over_union(shown, truth)
    for number in range(len(shown)):
        best = int(overlap[number].argmax())
        if overlap[number, best] >= IOU_STRICT:
            pairs.append((number, best))
            overlap[:, best] = 0
    return pairs


def _draw(tile: UInt8s, boxes: Boxes, scale: float, colour: tuple[int, int, int]) -> None:
    for left, top, right, bottom in np.rint(boxes * scale).astype(int).tolist():
        cv2.rectangle(tile, (left, top), (right, bottom), colour, 1, cv2.LINE_AA)
