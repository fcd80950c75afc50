"""A run of `simnfnd denoise`: how its files are denoised, and what came of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..pretrained import DEFAULT, POINTS
from ..recordings.inputs import InputFile
from .comparison_video import ComparisonVideo
from .denoiser import Denoiser
from .inverted import InvertedReport
from .journal import Journal
from .removed import RemovedReport
from .reports import FileReport, InTime, Row
from .sequences import Means, RunOptions
from .unchanged import UnchangedReport


class FansFound:
    """Counts the images whose fans were found, by folder or recording."""

    def __init__(self) -> None:
        self._images: dict[Path, list[bool]] = {}
        self._files: dict[Path, set[Path]] = {}

    def add(self, place: Path, file: Path, is_found: bool) -> None:
        """An image.  place: its folder or recording.  file: that it lies in."""
        self._images.setdefault(place, []).append(is_found)
        self._files.setdefault(place, set()).add(file)

    def __iter__(self) -> Any:
        """The name of each place, in how many images a fan was found, and how many there are."""
        for place, found in self._images.items():
            files = self._files[place]
            name = next(iter(files)) if len(files) == 1 else place
            yield str(name), sum(found), len(found)


@dataclass
class DenoisingJob:
    """How files are denoised, and into which folder; what came of it.

    points: gives what denoises shards of the paper's points.  workers: processes that denoise.
    bar: of progress, in images.
    used: names of weights, with how many files they denoised.  removed: from all of their images.
    unchanged: images that stayed as they were.  inverted: those with dark echoes.
    video: of all images side by side; None: none is asked for.
    rows: of the table, those that have a line at the end of the run.
    frame_rows: of the table of frames.  notes: lines on what was found in files.
    """

    out: Path
    options: RunOptions
    denoise: Denoiser
    points: Callable[[], Denoiser]
    means: Means
    journal: Journal
    workers: int = 1
    compare: bool = False
    bar: Any = None
    used: Counter[str] = field(default_factory=Counter)
    maps: Counter[str] = field(default_factory=Counter)
    fans: FansFound = field(default_factory=FansFound)
    in_time: InTime = field(default_factory=InTime)
    removed: RemovedReport = field(default_factory=RemovedReport)
    unchanged: UnchangedReport = field(default_factory=UnchangedReport)
    inverted: InvertedReport = field(default_factory=InvertedReport)
    video: ComparisonVideo | None = None
    rows: list[Row] = field(default_factory=list)
    frame_rows: list[Row] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @property
    def window(self) -> int:
        """Frames that are fused."""
        return self.options.frames

    def done(
        self,
        item: InputFile,
        report: FileReport,
        name: str,
        *,
        of_points: bool | None = None,
        result: Path | None = None,
        is_listed: bool = True,
    ) -> None:
        """A file is denoised by the weights of this name.

        of_points: whether its noise is that of the paper's points; None: not known.
        result: the file that was written, where it is not the usual one.
        is_listed: whether the file has a line of its own at the end of the run.
        """
        if of_points and name == DEFAULT:
            unsuited = f"{name} is made for real sonars; {POINTS} suits this file"
            self.warn(item, report, unsuited)
        elif of_points is False and name == POINTS:
            unsuited = f"{name} is made for the paper's points; {DEFAULT} suits this file"
            self.warn(item, report, unsuited)
        row = report.row(name)
        self.journal.add(item, row, result)
        if is_listed:
            self.rows.append(row)
        self.used[name] += 1
        self.maps.update(report.maps)
        self.in_time.merge(report.in_time)
        self.removed.merge(report.removed, report.name)
        self.unchanged.merge(report.unchanged)
        self.inverted.merge(report.inverted)

    def warn(self, item: InputFile, report: FileReport, warning: str) -> None:
        """A warning of a file, for the table and for the end of the run."""
        report.warnings.append(warning)
        self.warnings.append(f"{item.source}: {warning}")
