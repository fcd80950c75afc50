"""A sheet of crops: what every row made of some targets."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from ...factory.common.array_types import UInt8s
from ..metrics.measure import Grey
from .judge import SightingExample
from .targets import Sighting, Track, ellipse

_REACH_PX = 24  # from a target to the edge of its crop
_ENLARGEMENT = 3
_GAP_PX = 6
_CAPTION_PX = 34
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_MARK = (60, 200, 255)  # BGR
_TEXT = (235, 235, 235)


def crop_sheet(examples: Sequence[SightingExample], labels: Sequence[str]) -> bytes:
    """A PNG: two lines of crops for each example, and a column for each row of the benchmark.

    The first column outlines the target.  Below each image is what the target adds to it: the
    difference from the twin, which is what the row retains of the target.  All crops of a line have
    the grey scale of the recorded one.
    """
    side = _ENLARGEMENT * (2 * _REACH_PX + 1)
    columns = ["target (outlined)", *labels]
    width = _GAP_PX + len(columns) * (side + _GAP_PX)
    height = _CAPTION_PX + len(examples) * (2 * side + _GAP_PX + _CAPTION_PX)
    sheet: UInt8s = np.full((height, width, 3), 24, np.uint8)
    for column, label in enumerate(columns):
        _write_caption(sheet, label, _GAP_PX + column * (side + _GAP_PX), 4, side)
    for number, example in enumerate(examples):
        top = _CAPTION_PX + number * (2 * side + _GAP_PX + _CAPTION_PX)
        lower_top = top + side + _GAP_PX
        images, differences = _panels(example, labels)
        for column, (image, difference) in enumerate(zip(images, differences, strict=True)):
            left = _GAP_PX + column * (side + _GAP_PX)
            sheet[top : top + side, left : left + side] = image
            sheet[lower_top : lower_top + side, left : left + side] = difference
        caption = f"{example.track.target.label} (frame {example.sighting.frame})"
        caption_start = (_GAP_PX, lower_top + side + 14)
        cv2.putText(sheet, caption, caption_start, _FONT, 0.4, _TEXT, 1, cv2.LINE_AA)
    _, content = cv2.imencode(".png", sheet)
    return content.tobytes()


def _panels(example: SightingExample, labels: Sequence[str]) -> tuple[list[UInt8s], list[UInt8s]]:
    """The enlarged crops of an example, and what the target adds to each."""
    crops = [_crop(example.images[label].with_targets, example.sighting) for label in labels]
    twins = [_crop(example.images[label].without, example.sighting) for label in labels]
    added = [crop - twin for crop, twin in zip(crops, twins, strict=True)]
    low, high = np.quantile(crops[0], (0.02, 0.998))
    greatest = float(added[0].max())
    images = [_grey(crop, low, high) for crop in crops]
    differences = [_grey(difference, -greatest / 4, greatest) for difference in added]
    first_image = _outlined(images[0], example.track, example.sighting)
    first_difference = _outlined(differences[0], example.track, example.sighting)
    return (
        [first_image, *map(_enlarged, images)],
        [first_difference, *map(_enlarged, differences)],
    )


def _crop(image: Grey, sighting: Sighting) -> Grey:
    """The square around a target; beyond the frame it is black."""
    padded = np.pad(image, _REACH_PX)
    top = int(sighting.y)
    left = int(sighting.x)
    return padded[top : top + 2 * _REACH_PX + 1, left : left + 2 * _REACH_PX + 1]


def _grey(crop: Grey, low: float, high: float) -> UInt8s:
    """A crop as grey levels; `low` is black and `high` white."""
    scaled = np.clip((crop - low) / max(high - low, 1e-6), 0, 1)
    return np.asarray(np.rint(255 * scaled), np.uint8)


def _enlarged(crop: UInt8s) -> UInt8s:
    """(H, W, 3): a grey crop in colour, enlarged."""
    large = cv2.resize(
        crop, None, fx=_ENLARGEMENT, fy=_ENLARGEMENT, interpolation=cv2.INTER_NEAREST
    )
    return np.repeat(np.asarray(large, np.uint8)[..., None], 3, axis=2)


def _outlined(crop: UInt8s, track: Track, sighting: Sighting) -> UInt8s:
    """The crop enlarged, with a line around the target."""
    panel = np.ascontiguousarray(_enlarged(crop))
    centre_y = _ENLARGEMENT * (_REACH_PX + sighting.y % 1 + 0.5)
    centre_x = _ENLARGEMENT * (_REACH_PX + sighting.x % 1 + 0.5)
    axes = tuple(_ENLARGEMENT * (axis + 1.5) for axis in track.target.semi_axes_px)
    mask = ellipse(panel.shape[:2], centre_y, centre_x, track.angle_rad, axes)
    contours, _ = cv2.findContours(
        (mask > 0.5).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE
    )
    cv2.drawContours(panel, contours, -1, _MARK, 1)
    return panel


def _write_caption(sheet: UInt8s, label: str, left: int, top: int, width: int) -> None:
    """A caption in one line or two, as wide as its column."""
    lines = [""]
    for word in label.split():
        longer = f"{lines[-1]} {word}".strip()
        if cv2.getTextSize(longer, _FONT, 0.4, 1)[0][0] > width and lines[-1]:
            lines.append(word)
        else:
            lines[-1] = longer
    for number, line in enumerate(lines[:2]):
        line_start = (left, top + 10 + 13 * number)
        cv2.putText(sheet, line, line_start, _FONT, 0.4, _TEXT, 1, cv2.LINE_AA)
