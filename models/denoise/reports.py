"""What came of each file: a line, a row of a table, and what the whole run adds up.

The table, `denoised.csv` in the output folder, has a row for each result that is there.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...factory.common.array_types import Array
from ...factory.common.files import write_atomically
from .images import Denoised, SequenceDenoising
from .inverted import InvertedReport
from .removed import RemovedReport
from .temporal.strength import LEAST_MEASURED
from .unchanged import UnchangedReport

TABLE = "denoised.csv"
Row = dict[str, Any]
COLUMNS = (
    "file", "frames", "weights", "fused_frames", "moved_percent", "unmatched_frames",
    "repeated_frames", "network", "total_variation", "single_network", "single_total_variation",
    "strength_measured_on", "removed", "removed_frame", "removed_row", "removed_column",
    "removed_deviation", "removed_limit", "unchanged_images", "colour_maps", "warnings",
)  # fmt: skip


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
    warnings: list[str] = field(default_factory=list)

    def add(self, place: str, image: Array, denoised: Denoised) -> None:
        """An image of the file.  place: names it in the file; empty for the only one."""
        self.frames += 1
        self.removed.add(place, denoised.removed)
        self.unchanged.add(self.name, image, denoised.image)
        self.inverted.add(self.name, image, denoised.removed.noisy)

    def merge(self, other: FileReport, name: str) -> None:
        """Add one of several files of a sequence.  name: of the file."""
        self.frames += other.frames
        self.removed.merge(other.removed, name)
        self.unchanged.merge(other.unchanged)

    def row(self, weights: str, sequence: SequenceDenoising | None) -> Row:
        """The row of the table; what is not known or not measured is empty.

        weights: their name.  sequence: that the file was denoised in.
        """
        row: Row = dict.fromkeys(COLUMNS, "")
        row |= {"file": self.name, "frames": self.frames, "weights": weights}
        row["unchanged_images"] = self.unchanged.count
        if sequence is not None:
            row |= fusion_columns(sequence)
        worst = self.removed.worst
        if worst is not None:
            row |= _removed_columns(*worst, self.removed.limit())
        has_few_measured = 0 < (row["strength_measured_on"] or 0) < LEAST_MEASURED
        warnings = [*self.warnings]
        if has_few_measured:
            warnings.append("strength measured on too few frames")
        row["warnings"] = "; ".join(warnings)
        return row


def fusion_columns(sequence: SequenceDenoising) -> Row:
    """The columns of fusion and strength of a sequence."""
    tally = sequence.tally
    maps = ", ".join(sequence.maps)
    columns: Row = {"colour_maps": maps, "repeated_frames": int(tally["repeats"])}
    images = tally["images"]
    if images:
        columns["fused_frames"] = round(tally["frames"] / images, 2)
        columns["moved_percent"] = round(100 * tally["moved"] / images, 2)
        columns["unmatched_frames"] = int(tally["alone"])
    parts = sequence.strength.parts
    if parts.measured:
        columns |= {
            "network": round(parts.network, 3),
            "total_variation": round(parts.variation, 3),
            "single_network": round(parts.single_network, 3),
            "single_total_variation": round(parts.single_variation, 3),
            "strength_measured_on": parts.measured,
        }
    return columns


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
    few = f", fewer than the {LEAST_MEASURED} that tell anything" * (measured < LEAST_MEASURED)
    return (
        f"strength: {row['network']:.2f} network and {row['total_variation']:.2f} total variation "
        f"in whole windows, {row['single_network']:.2f} and {row['single_total_variation']:.2f} "
        f"in single frames (measured on {measured} frame{'s' * (measured != 1)}{few})"
    )


def _said_of_removed(row: Mapping[str, Any]) -> str:
    frame = f"frame {row['removed_frame']}, " if row["removed_frame"] != "" else ""
    spot = f"{frame}row {row['removed_row']}, column {row['removed_column']}"
    figures = f"{row['removed_deviation']:.1f}, limit {row['removed_limit']:.1f}"
    if row["removed"] == "none":
        return f"no structure removed (most suspicious: {spot}: {figures})"
    return f"removed structure: {row['removed']} at {spot} ({figures})"


def write_table(out: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the table.  Raises FactoryError."""
    text = io.StringIO()
    table = csv.DictWriter(text, COLUMNS, lineterminator="\n", extrasaction="ignore")
    table.writeheader()
    table.writerows(rows)
    write_atomically(out / TABLE, os.fsencode(text.getvalue()), key="--out")
