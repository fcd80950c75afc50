"""What moves in a recording: echoes that deviate from the background of its frames."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from typing import NamedTuple

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Float32s, UInt8s
from .frames import ShownFrame

BLOCK = 200  # frames whose median is the background
_MEDIAN_OF = 61  # frames of them, evenly spread, that the median is taken of
_BLUR_PX = 1.5
SEED = 6.0  # deviation, in standard deviations of the grain, that begins an echo
_EDGE = 3.0  # and that to which it reaches
_BODY = 0.35  # part of its peak that belongs to an echo; sidelobes are fainter
_SPLIT = 5.0  # times by which both parts exceed the gap between two echoes
_LEAST_PX = 6  # pixels of an echo


class Deviation(NamedTuple):
    """A frame minus its background, (H, W) float32, in standard deviations of the grain."""

    frame: ShownFrame
    values: Float32s


class Echo(NamedTuple):
    """A connected moving echo in one frame.

    x, y: its middle, weighted by the deviation, pixels.  box: left, top, right, bottom.
    peak: largest deviation.  long_axis: (2,) x and y of the direction of its longer side.
    length_px, width_px: along that axis and across it.
    """

    x: float
    y: float
    box: tuple[int, int, int, int]
    peak: float
    long_axis: tuple[float, float]
    length_px: float
    width_px: float


def deviations_of(frames: Iterable[ShownFrame]) -> Iterator[Deviation]:
    """Each frame minus the median over its block, frames shifted onto each other first."""
    stream = iter(frames)
    block = list(islice(stream, BLOCK))
    while block:
        following = list(islice(stream, BLOCK))
        if len(following) < BLOCK // 2:
            block += following
            following = []
        yield from _deviations_in(block)
        block = following


def _deviations_in(block: Sequence[ShownFrame]) -> Iterator[Deviation]:
    images = _registered([frame.image for frame in block])
    step = max(1, len(images) // _MEDIAN_OF)
    background = np.median(images[::step], axis=0).astype(np.float32)
    spread = 1.48 * np.median(np.abs(images[::step] - background), axis=0)
    grain = np.maximum(cv2.GaussianBlur(spread.astype(np.float32), (0, 0), 4), 1.0)
    smooth = cv2.GaussianBlur(background, (0, 0), 3)
    is_insonified = smooth > 4
    for frame, image in zip(block, images, strict=True):
        change = cv2.GaussianBlur((image - background) / grain, (0, 0), _BLUR_PX)
        values = np.where(is_insonified, change, 0).astype(np.float32)
        spread_now = (
            1.48 * float(np.median(np.abs(values[is_insonified]))) if is_insonified.any() else 1.0
        )
        yield Deviation(frame, values / np.float32(max(spread_now, 1e-3)))


def _registered(images: Sequence[UInt8s]) -> Float32s:
    """(T, H, W): images shifted by whole pixels onto the middle one."""
    middle = images[len(images) // 2].astype(np.float32)
    window = cv2.createHanningWindow(middle.shape[::-1], cv2.CV_32F)
    shifted = np.empty((len(images), *middle.shape), np.float32)
    for number, image in enumerate(images):
        values = image.astype(np.float32)
        (right, down), _ = cv2.phaseCorrelate(middle, values, window)
        shifted[number] = np.roll(values, (-round(down), -round(right)), (0, 1))
    return shifted


def echoes_in(deviation: Float32s) -> list[Echo]:
    """The moving echoes of a frame, brightest first."""
    echoes = list(_split(deviation, _EDGE, 0, 0))
    return sorted(echoes, key=lambda echo: -echo.peak)


def _split(values: Float32s, level: float, left: int, top: int) -> Iterator[Echo]:
    """The echoes in an area, whose upper left corner is given.

    Echoes are parted where the deviation between them falls below a part of both.
    """
    is_above = (values > level).astype(np.uint8)
    count, numbers, statistics, _ = cv2.connectedComponentsWithStats(is_above)
    for number in range(1, count):
        column, row, width, height, size = statistics[number].tolist()
        area = slice(row, row + height), slice(column, column + width)
        own = np.where(numbers[area] == number, values[area], np.float32(0))
        peak = float(own.max())
        if peak < SEED or size < _LEAST_PX:
            continue
        parts: list[Echo] = []
        if peak > _SPLIT * level:
            parts = list(_split(own, _SPLIT * level, left + column, top + row))
        if len(parts) > 1:
            yield from parts
        else:
            inside = own > max(level, _BODY * peak)
            values_inside = np.where(inside, own, np.float32(0)).astype(np.float32)
            yield _echo(values_inside, inside, left + column, top + row)


def _echo(values: Float32s, inside: Bools, left: int, top: int) -> Echo:
    rows, columns = np.nonzero(inside)
    weights = values[rows, columns]
    points = np.stack([columns + left + 0.5, rows + top + 0.5], 1)
    middle = np.average(points, axis=0, weights=weights)
    _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
    along, across = (np.ptp((points - middle) @ axis) + 1 for axis in axes)
    return Echo(
        float(middle[0]),
        float(middle[1]),
        (
            int(columns.min()) + left,
            int(rows.min()) + top,
            int(columns.max()) + left + 1,
            int(rows.max()) + top + 1,
        ),
        float(values.max()),
        (float(axes[0, 0]), float(axes[0, 1])),
        float(along),
        float(across),
    )
