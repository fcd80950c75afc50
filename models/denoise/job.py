"""A run of `simnfnd denoise`: how its files are denoised, and what came of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..pretrained import DEFAULT, POINTS
from ..recordings.inputs import Geometries, InputFile
from .comparison_video import ComparisonVideo
from .denoiser import Denoiser
from .images import Denoising, SequenceDenoising
from .inverted import InvertedReport
from .journal import Journal
from .removed import RemovedReport
from .reports import FileReport, Row
from .unchanged import UnchangedReport


@dataclass
class DenoisingJob:
    """How files are denoised, and into which folder; what came of it.

    points: gives what denoises shards of the paper's points.  topics: of bags, whose images;
    none: as `RosBag` says.  bar: of progress, in images.
    used: names of weights, with how many files they denoised.  removed: from all of their images.
    unchanged: images that stayed as they were.  inverted: those with dark echoes.
    video: of all images side by side; None: none is asked for.
    rows: of the table, those that have a line at the end of the run.
    """

    out: Path
    denoise: Denoiser
    points: Callable[[], Denoiser]
    denoising: Denoising
    geometries: Geometries
    journal: Journal
    compare: bool = False
    topics: Sequence[str] = ()
    bar: Any = None
    used: Counter[str] = field(default_factory=Counter)
    removed: RemovedReport = field(default_factory=RemovedReport)
    unchanged: UnchangedReport = field(default_factory=UnchangedReport)
    inverted: InvertedReport = field(default_factory=InvertedReport)
    video: ComparisonVideo | None = None
    rows: list[Row] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def done(
        self,
        item: InputFile,
        report: FileReport,
        name: str,
        *,
        sequence: SequenceDenoising | None = None,
        of_points: bool | None = None,
        result: Path | None = None,
        is_listed: bool = True,
    ) -> None:
        """A file is denoised by the weights of this name.

        sequence: that it was denoised in, where that is its alone.
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
        row = report.row(name, sequence)
        self.journal.add(item, row, result)
        if is_listed:
            self.rows.append(row)
        self.used[name] += 1
        self.removed.merge(report.removed, report.name)
        self.unchanged.merge(report.unchanged)
        self.inverted.merge(report.inverted)

    def warn(self, item: InputFile, report: FileReport, warning: str) -> None:
        """A warning of a file, for the table and for the end of the run."""
        report.warnings.append(warning)
        self.warnings.append(f"{item.source}: {warning}")
