"""What came of each file: a line, a row of a table, and what the whole run adds up.

The table, `denoised.csv` in the output folder, has a row for each result that is there.
"""

from __future__ import annotations

import csv
import io
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...factory.common.files import write_atomically
from ..recordings.device_settings import RecordedSettings
from ..recordings.palettes import SUM
from .inverted import InvertedReport
from .records import FrameRecord
from .removed import RemovedReport
from .temporal.stream import FrameFacts
from .unchanged import UnchangedReport

TABLE = "denoised.csv"
Row = dict[str, Any]
COLUMNS = (
    "file", "frames", "weights", "fused_frames", "moved_percent", "unmatched_frames",
    "repeated_frames", "network", "total_variation", "strength_measured_on", "removed",
    "removed_frame", "removed_row", "removed_column", "removed_deviation", "removed_limit",
    "unchanged_images", "colour_maps", "warnings",
)  # fmt: skip
FRAME_COLUMNS = (
    "file", "frame", "time_s", "shift_x_px", "shift_y_px", "rotation_deg", "frames_fused",
    "deviating_share",
)  # fmt: skip
_LEAST_MEASURED = 3
"""Frames from which on a strength tells more of the recording than of one frame."""
_MOST_NAMED = 6  # kinds of frames


@dataclass
class _Kind:
    """Frames that may be fused with each other, by number: the first, the last, and how many."""

    settings: RecordedSettings
    first: int
    last: int
    count: int = 0


class Kinds:
    """The kinds of frames of a recording; see `temporal.grouping`."""

    def __init__(self) -> None:
        self._kinds: list[_Kind] = []
        self._kind_of: dict[int, _Kind] = {}

    def add(self, number: int, previous: int, settings: RecordedSettings) -> None:
        """The next frame.  previous: the one before it of its kind."""
        kind = self._kind_of.get(previous)
        if kind is None:
            kind = _Kind(settings, number, number)
            self._kinds.append(kind)
        kind.last = number
        kind.count += 1
        self._kind_of[number] = kind

    def summary(self) -> Iterator[str]:
        """A line where there are several kinds."""
        if len(self._kinds) > 1:
            said = ", ".join(self._said(kind) for kind in self._kinds[:_MOST_NAMED])
            more = len(self._kinds) - _MOST_NAMED
            said += f" and {more} more" if more > 0 else ""
            yield (
                f"kinds of frames: {len(self._kinds)}, each denoised among its like: {said}; "
                "if that is wrong, --frames 1 denoises each frame alone"
            )

    def _said(self, kind: _Kind) -> str:
        """A kind by what tells it from the others, with its frames."""
        texts = [
            text
            for other in self._kinds[: 2 * _MOST_NAMED]
            if other is not kind
            for text in kind.settings.differences(other.settings)
        ]
        name = ", ".join(dict.fromkeys(texts)) or f"like frame {kind.first}"
        plural = "s" * (kind.count != 1)
        return f"{name} ({kind.count} frame{plural}, {kind.first} to {kind.last})"


@dataclass
class InTime:
    """Sums over the frames of a run or file that were denoised among others.

    frames: but for copies.  fused, moved: sums of the mean number of frames that were averaged at
    a pixel, and of the share of pixels that moved.  unmatched: frames that matched no other.
    """

    frames: int = 0
    fused: float = 0.0
    moved: float = 0.0
    unmatched: int = 0
    copies: int = 0

    def add(self, facts: FrameFacts) -> None:
        """Count a frame."""
        if facts.is_copy:
            self.copies += 1
            return
        self.frames += 1
        self.fused += facts.fused
        self.moved += facts.deviating
        self.unmatched += facts.fused <= 1

    def merge(self, other: InTime) -> None:
        """Add the sums of another file."""
        self.frames += other.frames
        self.fused += other.fused
        self.moved += other.moved
        self.unmatched += other.unmatched
        self.copies += other.copies

    def summary(self, window: int) -> Iterator[str]:
        """Lines on what was fused.  window: the most frames that are."""
        if self.frames:
            yield (
                f"in time: {self.fused / self.frames:.1f} of up to {window} frames "
                f"fused in a pixel, {100 * self.moved / self.frames:.1f} % of pixels moved, "
                f"{self.unmatched} of {self.frames} frames matched no neighbour"
            )
        if self.copies:
            yield (
                f"repeated frames: {self.copies} of {self.frames + self.copies} are copies of the "
                "one before and were fused once"
            )


@dataclass
class FileReport:
    """What became of one file.

    name: of its result below the output folder.  frames: denoised until now.
    """

    name: str
    frames: int = 0
    removed: RemovedReport = field(default_factory=RemovedReport)
    unchanged: UnchangedReport = field(default_factory=UnchangedReport)
    inverted: InvertedReport = field(default_factory=InvertedReport)
    in_time: InTime = field(default_factory=InTime)
    maps: Counter[str] = field(default_factory=Counter)
    strength: list[tuple[float, float, float]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def add(self, place: str, record: FrameRecord) -> None:
        """An image of the file.  place: names it in the file; empty for the only one."""
        facts = record.facts
        self.frames += 1
        self.removed.add(place, record.structure)
        if record.unchanged:
            self.unchanged.add(self.name, bright_border=record.bright_border)
        self.inverted.add(self.name, inverted=record.inverted)
        if record.colour_map:
            self.maps[record.colour_map] += 1
        if facts.fused:
            self.in_time.add(facts)
            self.strength.append((facts.network, facts.variation, facts.measured))

    def merge(self, other: FileReport, name: str) -> None:
        """Add one of several files of a sequence.  name: of the file."""
        self.frames += other.frames
        self.removed.merge(other.removed, name)
        self.unchanged.merge(other.unchanged)
        self.in_time.merge(other.in_time)
        self.maps.update(other.maps)
        self.strength += other.strength

    def row(self, weights: str) -> Row:
        """The row of the table; what is not known or not measured is empty.

        weights: their name.
        """
        row: Row = dict.fromkeys(COLUMNS, "")
        row |= {"file": self.name, "frames": self.frames, "weights": weights}
        row["unchanged_images"] = self.unchanged.count
        row["colour_maps"] = ", ".join(self.maps)
        if self.strength:
            row |= self._fusion_columns()
        worst = self.removed.worst
        if worst is not None:
            row |= _removed_columns(*worst, self.removed.limit())
        has_few_measured = 0 < (row["strength_measured_on"] or 0) < _LEAST_MEASURED
        warnings = [*self.warnings]
        if has_few_measured:
            warnings.append("strength measured on too few frames")
        row["warnings"] = "; ".join(warnings)
        return row

    def _fusion_columns(self) -> Row:
        """The columns of fusion and strength."""
        in_time = self.in_time
        columns: Row = {"repeated_frames": in_time.copies}
        if in_time.frames:
            columns["fused_frames"] = round(in_time.fused / in_time.frames, 2)
            columns["moved_percent"] = round(100 * in_time.moved / in_time.frames, 2)
            columns["unmatched_frames"] = in_time.unmatched
        network, variation, measured = (
            sum(values) / len(self.strength) for values in zip(*self.strength, strict=True)
        )
        if measured:
            columns["network"] = round(network, 3)
            columns["total_variation"] = round(variation, 3)
            columns["strength_measured_on"] = max(round(measured), 1)
        return columns


def said_of_maps(maps: Counter[str]) -> Iterator[str]:
    """A line if colours stood for levels."""
    if maps:
        named = ", ".join(f"{name} in {count}" for name, count in maps.items())
        yield (
            f"colour maps: {named}; their levels were denoised and painted again "
            f"({SUM}: a map that is not known, by the sum of its channels)"
        )


def frame_row(file: str, number: int, time_s: float | None, facts: FrameFacts) -> Row:
    """The row of a frame in the table of frames."""
    numbers = (*facts[4:7], max(facts.fused, 1), facts.deviating)
    rounded = [round(value, 4) + 0.0 for value in numbers]
    time = "" if time_s is None else time_s
    return dict(zip(FRAME_COLUMNS, (file, number, time, *rounded), strict=True))


def _removed_columns(place: str, structure: Any, limit: float) -> Row:
    is_structure = abs(structure.deviation) > limit
    kind = "echo" if structure.deviation > 0 else "shadow"
    return {
        "removed": kind if is_structure else "none",
        "removed_frame": place.rpartition(" ")[2].rstrip(", "),
        "removed_row": structure.row,
        "removed_column": structure.column,
        "removed_deviation": round(abs(structure.deviation), 2),
        "removed_limit": round(limit, 2),
    }


def line_of(row: Mapping[str, Any], window: int) -> str:
    """A row as a sentence.  window: the most frames that are fused."""
    frames = row["frames"]
    parts = [f"{frames} frame{'s' * (frames != 1)}"]
    if row["fused_frames"] != "":
        parts.append(f"{row['fused_frames']:.1f} of up to {window} fused")
        parts.append(f"{row['moved_percent']:.1f} % of pixels moved")
        parts.append(f"{row['unmatched_frames']} matched no neighbour")
    if row["repeated_frames"]:
        parts.append(f"{row['repeated_frames']} repeated")
    said = ", ".join(parts)
    if row["strength_measured_on"] != "":
        said += "; " + _said_of_strength(row)
    if row["removed"] != "":
        said += "; " + _said_of_removed(row)
    if row["unchanged_images"]:
        said += f"; {row['unchanged_images']} unchanged"
    return f"{row['file']}: {said}"


def _said_of_strength(row: Mapping[str, Any]) -> str:
    measured = row["strength_measured_on"]
    few = f", fewer than the {_LEAST_MEASURED} that tell anything" * (measured < _LEAST_MEASURED)
    return (
        f"strength: {row['network']:.2f} network and {row['total_variation']:.2f} total variation "
        f"in whole windows (measured on {measured} frame{'s' * (measured != 1)}{few})"
    )


def _said_of_removed(row: Mapping[str, Any]) -> str:
    frame = f"frame {row['removed_frame']}, " if row["removed_frame"] != "" else ""
    spot = f"{frame}row {row['removed_row']}, column {row['removed_column']}"
    figures = f"{row['removed_deviation']:.1f}, limit {row['removed_limit']:.1f}"
    if row["removed"] == "none":
        return f"no structure removed (most suspicious: {spot}: {figures})"
    return f"removed structure: {row['removed']} at {spot} ({figures})"


def write_table(out: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the table of all results.  Raises FactoryError when there is no room for it."""
    write_rows(out / TABLE, COLUMNS, rows, key="--out")


def write_rows(
    path: Path, columns: Sequence[str], rows: Iterable[Mapping[str, Any]], *, key: str
) -> None:
    """Write a CSV table.  key: the option that names it, for errors.  Raises FactoryError."""
    text = io.StringIO()
    table = csv.DictWriter(text, columns, lineterminator="\n", extrasaction="ignore")
    table.writeheader()
    table.writerows(rows)
    write_atomically(path, os.fsencode(text.getvalue()), key=key)
