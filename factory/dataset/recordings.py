"""Recordings of a dataset: the frames of a scene in the order of time, whole or in windows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

from ..common.array_types import Array, Float64s
from ..common.errors import FactoryError
from ..common.small_files import parse_json
from .schema import CORE

Track = dict[str, Any]

WINDOW_FRAMES = 7
STATIC = "static"


@dataclass(frozen=True, eq=False)
class FrameSequence:
    """T frames of one recording, one after another.

    recording: `location/scene`.  frames: (T,) their names.
    time_s: (T,) float64, NaN where the dataset has no times (`dataset.columns=[pose]` stores them).
    noisy, clean: (T, H, W).  static: (T, H, W) the clean scene without moving objects, None where
        the dataset has no such layer.
    truth: (T, H, W) of each other layer of the dataset, such as shadow and instance.
    tracks: T lists of moving objects, see the column `tracks`; empty lists without that column.
    """

    recording: str
    frames: tuple[str, ...]
    time_s: Float64s
    noisy: Array
    clean: Array
    static: Array | None
    truth: Mapping[str, Array]
    tracks: tuple[tuple[Track, ...], ...]

    def __len__(self) -> int:
        return len(self.frames)


class _Row(NamedTuple):
    """A sample: its number in the dataset, the name and number of its frame, and its time."""

    record: np.void
    sample: int
    frame: str
    number: int | None
    time_s: float
    tracks: tuple[Track, ...]


def is_of_recordings(config: Mapping[str, Any]) -> bool:
    """Whether the frames of a dataset's scenes are pings of one sonar, one after another.

    config: as shards and manifest state it.
    """
    scenes = config.get("scenes")
    if not isinstance(scenes, Mapping):
        return False
    if scenes.get("frame_rate_hz") is not None or scenes.get("moving_objects"):
        return True
    own_objects = scenes.get("own_objects")
    if not isinstance(own_objects, list):
        return False
    return any(isinstance(item, Mapping) and item.get("moving") for item in own_objects)


class SampleSource(Protocol):
    """The part of `PairDataset` that its recordings are made of."""

    @property
    def folder(self) -> Path:
        """The folder of the dataset."""

    @property
    def split(self) -> str:
        """The split that is open."""

    def meta(self) -> npt.NDArray[np.void]:
        """The sample table, (samples,)."""

    def __getitem__(self, samples: list[int], /) -> Mapping[str, Array]:
        """Layer -> (N, H, W) images of N samples."""


class DatasetRecordings:
    """The recordings of an open dataset, of one variant of the noise.

    Reads the tables of all shards once, and images when they are asked for.
    """

    def __init__(self, pairs: SampleSource, variant: int = 0) -> None:
        self._pairs = pairs
        self._rows: dict[str, list[_Row]] = {}
        for sample, record in enumerate(pairs.meta()):
            if int(record["variant"]) == variant:
                name = f"{record['location'].decode()}/{record['scene'].decode()}".lstrip("/")
                self._rows.setdefault(name, []).append(_row(sample, record))
        for rows in self._rows.values():
            rows.sort(key=_order)

    @property
    def names(self) -> tuple[str, ...]:
        """`location/scene` of each recording, in the order of the dataset."""
        return tuple(self._rows)

    def sequence(self, name: str) -> FrameSequence:
        """All frames of a recording.  Raises FactoryError for a name that the dataset lacks."""
        return self._read(name, self._rows_of(name))

    def samples(self, name: str) -> tuple[int, ...]:
        """Numbers of the samples of a recording.  Raises FactoryError as `sequence` does."""
        return tuple(row.sample for row in self._rows_of(name))

    def _rows_of(self, name: str) -> list[_Row]:
        if name not in self._rows:
            known = ", ".join(self.names[:3])
            raise FactoryError(
                f"{self._pairs.folder}: no recording {name!r} in the split {self._pairs.split}; "
                f"there are {len(self.names)}, such as {known}"
            )
        return self._rows[name]

    def windows(self, frames: int = WINDOW_FRAMES, step: int = 1) -> Iterator[FrameSequence]:
        """Windows of `frames` frames without a gap, every `step`-th of each recording."""
        for name, rows in self._rows.items():
            for start in self.starts(name, frames)[::step]:
                yield self._read(name, rows[start : start + frames])

    def starts(self, name: str, frames: int) -> list[int]:
        """Where windows without a gap begin, indices in the recording."""
        rows = self._rows[name]
        numbers = [row.number for row in rows]
        if any(number is None for number in numbers):
            return list(range(len(rows) - frames + 1))
        steps = np.diff(np.array(numbers, np.int64))
        if not len(steps):
            return [0] if frames == 1 else []
        is_gap = np.append(0, np.cumsum(steps != steps.min()))
        last = len(rows) - frames + 1
        return [start for start in range(last) if is_gap[start] == is_gap[start + frames - 1]]

    def record(self, name: str) -> np.void:
        """The row of the sample table of a recording's first frame."""
        return self._rows[name][0].record

    def window(self, name: str, start: int, frames: int) -> FrameSequence:
        """The window that begins at an index of `starts`."""
        return self._read(name, self._rows[name][start : start + frames])

    def _read(self, name: str, rows: list[_Row]) -> FrameSequence:
        images = self._pairs[[row.sample for row in rows]]
        if missing := set(CORE[:2]).difference(images):
            raise FactoryError(
                f"layers: recordings need {' and '.join(sorted(missing))}, too; open the dataset "
                "with layers=('noisy', 'clean')"
            )
        others = {key: stack for key, stack in images.items() if key not in (*CORE[:2], STATIC)}
        return FrameSequence(
            recording=name,
            frames=tuple(row.frame for row in rows),
            time_s=np.array([row.time_s for row in rows]),
            noisy=images["noisy"],
            clean=images["clean"],
            static=images.get(STATIC),
            truth=others,
            tracks=tuple(row.tracks for row in rows),
        )


def _order(row: _Row) -> tuple[float, int, str]:
    """By time, then by the number of the frame, then by its name."""
    time_s = row.time_s if np.isfinite(row.time_s) else 0.0
    number = -1 if row.number is None else row.number
    return time_s, number, row.frame


def _row(sample: int, record: np.void) -> _Row:
    names = record.dtype.names or ()
    frame = record["frame"].decode()
    time_s = float(record["time_s"]) if "time_s" in names else float("nan")
    tracks = parse_tracks(record["tracks"], f"sample {sample}") if "tracks" in names else ()
    return _Row(record, sample, frame, int(frame) if frame.isdigit() else None, time_s, tracks)


def parse_tracks(text: bytes, source: str) -> tuple[Track, ...]:
    """The entries of the column `tracks`.

    Raises FactoryError, which names `source`, when they are not of the form that it describes.
    """
    try:
        entries = parse_json(text)
    except ValueError as error:
        raise FactoryError(f"{source}: its tracks are damaged ({error})") from error
    if not isinstance(entries, list) or not all(map(_is_track, entries)):
        raise FactoryError(f"{source}: its tracks are damaged (no list of objects)")
    return tuple(entries)


def _is_track(entry: object) -> bool:
    if not isinstance(entry, dict) or not isinstance(entry.get("class"), str):
        return False
    box = entry.get("box")
    occluded = entry.get("occluded")
    is_box = box is None or (
        isinstance(box, list) and len(box) == 4 and all(isinstance(n, int) for n in box)
    )
    return is_box and isinstance(entry.get("id"), int) and isinstance(occluded, int | float)
