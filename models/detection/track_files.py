"""Files that `simnfnd detect --count` writes: tracks.csv, MOT, an echogram, a video with tracks."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np

from ...factory.common.array_types import Float32s, UInt8s
from ...factory.common.files import write_atomically
from ...factory.dataset.fan_geometry import FanGeometry
from .counting import CLASS, TrackRow
from .files import Overlay
from .frames import ShownFrame
from .moving import SEED, Deviation
from .objects import DetectedObject, metres_per_pixel, place_of
from .tracker import Track, TrackPoint

_DIGITS = 3
_MOST_COLUMNS = 1600  # frames of an echogram beside each other; more are joined by their maximum
_ROWS = 400
_BRIGHT = 12.0  # deviation that is white
_MARGIN_PX = (46, 26)  # left and lower, for the axes
_COLOURS = ((80, 80, 255), (80, 220, 80), (255, 160, 60), (60, 220, 255), (230, 110, 230))  # BGR
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def write_tracks(path: Path, rows: Sequence[TrackRow]) -> None:
    """Write the table of all tracks."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["class" if name == "class_name" else name for name in TrackRow._fields])
    for row in rows:
        table.writerow(
            [round(value, _DIGITS) if isinstance(value, float) else value for value in row]
        )
    write_atomically(path, text.getvalue().encode(), key="--out")


def write_mot(path: Path, tracks: Sequence[Track]) -> None:
    """Write results as MOTChallenge has them: frames and pixels count from 1."""
    lines = []
    for number, track in enumerate(tracks, start=1):
        for point in track.points:
            left, top, right, bottom = point.echo.box
            box = f"{left + 1},{top + 1},{right - left},{bottom - top}"
            frame = point.frame.number + 1
            lines.append((frame, f"{frame},{number},{box},{score_of(point):.3f},-1,-1,-1\n"))
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, "".join(line for _, line in sorted(lines)).encode(), key="--out")


def score_of(point: TrackPoint) -> float:
    """How far an echo stands out, 0 to 1; no probability."""
    return point.echo.peak / (point.echo.peak + SEED)


def object_of(point: TrackPoint) -> DetectedObject:
    """An echo of a track as other programs get it."""
    left, top, right, bottom = (float(side) for side in point.echo.box)
    geometry = point.frame.geometry
    if geometry is None:
        return DetectedObject(CLASS, score_of(point), left, top, right, bottom)
    place = place_of(geometry, point.echo.x, point.echo.y)
    scale_m = metres_per_pixel(geometry)
    size_m = None if scale_m is None else scale_m * max(right - left, bottom - top)
    return DetectedObject(CLASS, score_of(point), left, top, right, bottom, *place, size_m)


class Echogram:
    """Range over time: the largest deviation at each range, frame by frame.

    frames: number, time_s, height and width of each.
    """

    def __init__(self) -> None:
        self._columns: list[Float32s] = []
        self._numbers: list[int] = []
        self.frames: list[tuple[int, float | None, int, int]] = []
        self._rows: Float32s | None = None
        self._geometry: FanGeometry | None = None

    def add(self, deviation: Deviation) -> None:
        """The next frame."""
        if self._rows is None:
            self._geometry = deviation.frame.geometry
            self._rows = _row_of_pixels(deviation.frame)
        column = np.zeros(_ROWS, np.float32)
        is_bright = deviation.values > 1
        np.maximum.at(column, self._rows[is_bright].astype(int), deviation.values[is_bright])
        self._columns.append(column)
        self._numbers.append(deviation.frame.number)
        height, width = deviation.values.shape
        self.frames.append((deviation.frame.number, deviation.frame.time_s, height, width))

    def image(self, tracks: Sequence[Track]) -> UInt8s:
        """The echogram with its tracks and axes, (H, W, 3) BGR; near range at the bottom."""
        step = -(-len(self._columns) // _MOST_COLUMNS)
        columns = np.stack(self._columns, 1)
        joined = np.maximum.reduceat(columns, np.arange(0, columns.shape[1], step), axis=1)
        wide = max(1, 800 // joined.shape[1])
        grey = np.repeat(np.clip(joined * (255 / _BRIGHT), 0, 255).astype(np.uint8), wide, axis=1)
        left, lower = _MARGIN_PX
        image: UInt8s = np.full((_ROWS + lower, grey.shape[1] + left, 3), 24, np.uint8)
        image[:_ROWS, left:] = grey[::-1, :, None]
        place = {number: index // step for index, number in enumerate(self._numbers)}
        assert self._rows is not None
        for number, track in enumerate(tracks):
            colour = _COLOURS[number % len(_COLOURS)]
            line = np.array(
                [
                    (left + (place[p.frame.number] + 0.5) * wide, _ROWS - 1 - self._row_of(p))
                    for p in track.points
                ]
            )
            cv2.polylines(image, [np.rint(line).astype(np.int32)], False, colour, 1, cv2.LINE_AA)
            start = (int(line[0, 0]), int(line[0, 1]) - 4)
            cv2.putText(image, str(number + 1), start, _FONT, 0.45, colour, 1, cv2.LINE_AA)
        self._draw_axes(image, wide, step)
        return image

    def _row_of(self, point: TrackPoint) -> float:
        assert self._rows is not None
        height, width = self._rows.shape
        row = min(max(int(point.echo.y), 0), height - 1)
        return float(self._rows[row, min(max(int(point.echo.x), 0), width - 1)])

    def _draw_axes(self, image: UInt8s, wide: int, step: int) -> None:
        left, lower = _MARGIN_PX
        white = (235, 235, 235)
        geometry = self._geometry
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            y = round((1 - share) * (_ROWS - 1))
            text = f"{100 * share:.0f} %"
            if geometry is not None and geometry.range_span_m is not None:
                assert geometry.range_min_m is not None
                text = f"{geometry.range_min_m + share * geometry.range_span_m:.1f} m"
            cv2.putText(image, text, (2, min(max(y + 4, 10), _ROWS - 2)), _FONT, 0.35, white, 1)
        width = image.shape[1] - left
        for share in (0.0, 0.25, 0.5, 0.75):
            frame = self._numbers[min(int(share * width / wide) * step, len(self._numbers) - 1)]
            position = (left + round(share * width), image.shape[0] - lower // 3)
            cv2.putText(image, f"frame {frame}", position, _FONT, 0.35, white, 1)


def _row_of_pixels(frame: ShownFrame) -> Float32s:
    """(H, W) row of an echogram that each pixel belongs to, 0 at the near range."""
    height, width = frame.image.shape
    geometry = frame.geometry
    if geometry is None:
        # Far range on top.
        share = np.repeat(1 - (np.arange(height) + 0.5)[:, None] / height, width, axis=1)
    else:
        fraction = geometry.maps(0, 0, height, width)["range_fraction"]
        share = (fraction - geometry.near_fraction) / max(1e-6, 1 - geometry.near_fraction)
    return np.asarray(np.clip(share * (_ROWS - 1), 0, _ROWS - 1), np.float32)


def write_image(path: Path, image: UInt8s) -> None:
    """Write a PNG."""
    _, content = cv2.imencode(".png", image)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.tobytes(), key="--out")


def draw_tracks(overlay: Overlay, frames: Iterable[ShownFrame], tracks: Sequence[Track]) -> None:
    """Add the frames of a recording to a video, with the tracks that are seen in each."""
    shown: dict[int, list[tuple[DetectedObject, str]]] = {}
    for number, track in enumerate(tracks, start=1):
        for point in track.points:
            shown.setdefault(point.frame.number, []).append((object_of(point), str(number)))
    for frame in frames:
        overlay.add(frame, shown.get(frame.number, []))
