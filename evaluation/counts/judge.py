"""Counts, tracks and lengths of a dataset of recordings against its truth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Float32s
from ...factory.dataset.fan_geometry import FanGeometry, recorded_sonar
from ...factory.dataset.pair_dataset import PairDataset
from ...factory.dataset.recordings import Track as TrueTrack
from ...factory.dataset.schema import stored_image
from ...models.detection.boxes import no_boxes
from ...models.detection.counting import TrackRow, rows_of, way_direction
from ...models.detection.frames import ShownFrame
from ...models.detection.moving import deviations_of
from ...models.detection.tracker import Track, track_echoes
from .scores import TrackedFrame, TrackScores, count_error, score_tracks

_FEWEST = 5  # frames with a box of an object that is to be counted
_VISIBLE = 0.5  # part of them in which it is not hidden
_HIDDEN = 0.5  # from this part of its outline on it counts as hidden


class MeasuredLength(NamedTuple):
    """A counted object with its length: true and estimated, metres, and its mean range."""

    true_m: float
    estimated_m: float
    range_m: float


@dataclass(frozen=True, eq=False)
class RecordingCounts:
    """What was counted in a recording.  true, found: number of objects by direction."""

    name: str
    true: Counter[str]
    found: Counter[str]
    scores: TrackScores
    lengths: Sequence[MeasuredLength]

    @property
    def error(self) -> int:
        """Sum over directions of the difference."""
        return count_error(self.true, self.found)


def judge_dataset(folder: Path) -> Iterator[RecordingCounts]:
    """Count in all recordings of a dataset.  Raises FactoryError for one without tracks."""
    with PairDataset(folder, "all", layers=("noisy", "clean")) as pairs:
        sonar = recorded_sonar(pairs.form.config)
        for name in pairs.recordings.names:
            sequence = pairs.recordings.sequence(name)
            record = pairs.recordings.record(name)
            geometry = None if sonar is None else FanGeometry.from_record(sonar, record)
            frames = [
                ShownFrame(number, stored_image(image, "uint8"), geometry, float(time_s))
                for number, (image, time_s) in enumerate(
                    zip(sequence.noisy, sequence.time_s, strict=True)
                )
            ]
            yield _judge(name, frames, sequence.tracks)


def _judge(
    name: str, frames: Sequence[ShownFrame], truth: Sequence[Sequence[TrueTrack]]
) -> RecordingCounts:
    tracks = track_echoes(deviations_of(frames))
    rows = rows_of(name, tracks)
    seen = _countable(truth)
    true = Counter(_direction(entries) for entries in seen.values())
    found = Counter(row.direction for row in rows)
    true_frames = [
        _frame([(entry["id"], entry["box"]) for entry in frame if entry["id"] in seen])
        for frame in truth
    ]
    found_frames = _found_frames(tracks, len(frames))
    scores = score_tracks(true_frames, found_frames)
    return RecordingCounts(name, true, found, scores, _lengths(tracks, rows, true_frames, seen))


def _countable(truth: Sequence[Sequence[TrueTrack]]) -> dict[int, list[TrueTrack]]:
    """Id -> entries with a box, of the objects that are seen long and clearly enough."""
    entries: dict[int, list[TrueTrack]] = {}
    for frame in truth:
        for entry in frame:
            if entry["box"] is not None:
                entries.setdefault(entry["id"], []).append(entry)
    return {
        number: own
        for number, own in entries.items()
        if len(own) >= _FEWEST
        and np.mean([entry["occluded"] < _HIDDEN for entry in own]) >= _VISIBLE
    }


def _direction(entries: Sequence[TrueTrack]) -> str:
    range_m = np.array([entry["range_m"] for entry in entries])
    bearing = np.deg2rad([entry["bearing_deg"] for entry in entries])
    return way_direction(np.stack([range_m * np.cos(bearing), range_m * np.sin(bearing)], 1))


def _frame(entries: Sequence[tuple[int, Sequence[float] | None]]) -> TrackedFrame:
    """Numbers and boxes of a frame.  entries: with left, top, width and height."""
    boxes = [(number, box) for number, box in entries if box is not None]
    if not boxes:
        return TrackedFrame((), no_boxes())
    corners = [[left, top, left + width, top + height] for _, (left, top, width, height) in boxes]
    return TrackedFrame(tuple(number for number, _ in boxes), np.array(corners, np.float32))


def _found_frames(tracks: Sequence[Track], frame_count: int) -> list[TrackedFrame]:
    by_frame: list[list[tuple[int, Float32s]]] = [[] for _ in range(frame_count)]
    for number, track in enumerate(tracks, start=1):
        for point in track.points:
            box = np.array(point.echo.box, np.float32)
            by_frame[point.frame.number].append((number, box))
    return [
        TrackedFrame(
            tuple(number for number, _ in found),
            np.array([box for _, box in found], np.float32).reshape(-1, 4),
        )
        for found in by_frame
    ]


def _lengths(
    tracks: Sequence[Track],
    rows: Sequence[TrackRow],
    truth: Sequence[TrackedFrame],
    seen: dict[int, list[TrueTrack]],
) -> list[MeasuredLength]:
    """Lengths of the tracks that lie on one true object most of the time."""
    lengths = []
    for track, row in zip(tracks, rows, strict=True):
        votes: Counter[int] = Counter()
        for point in track.points:
            frame = truth[point.frame.number]
            middle = np.array([point.echo.x, point.echo.y])
            inside = (frame.boxes[:, :2] <= middle).all(1) & (middle <= frame.boxes[:, 2:]).all(1)
            votes.update(np.array(frame.numbers, int)[inside].tolist())
        if not votes or row.length_m is None:
            continue
        number, count = votes.most_common(1)[0]
        true_m = seen[number][0].get("length_m")
        if true_m is not None and count > len(track.points) / 2:
            range_m = row.slant_range_m or math.nan
            lengths.append(MeasuredLength(float(true_m), row.length_m, range_m))
    return lengths
