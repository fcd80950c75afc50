"""A run of `simnfnd denoise`: how its files are denoised, and what came of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..pretrained import DEFAULT, POINTS
from ..recordings.inputs import Geometries, Item
from .comparison_video import ComparisonVideo
from .denoiser import Denoiser
from .images import Denoising
from .inverted import InvertedReport
from .journal import Journal
from .removed import RemovedReport
from .unchanged import UnchangedReport


@dataclass
class Job:
    """How files are denoised, and into which folder; what came of it.

    points: gives what denoises shards of the paper's points.  topics: of bags, whose images;
    none: as `RosBag` says.  bar: of progress, in images.
    used: names of weights, with how many files they denoised.  removed: from all of their images.
    unchanged: images that stayed as they were.  inverted: those with dark echoes.
    video: of all images side by side; None: none is asked for.
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
    failures: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def done(self, item: Item, name: str, *, of_points: bool | None = None) -> None:
        """A file is denoised by the weights of this name.

        of_points: whether its noise is that of the paper's points; None: not known.
        """
        self.journal.add(item)
        self.used[name] += 1
        if of_points is None:
            return
        if of_points and name == DEFAULT:
            unsuited = f"{name} is made for real sonars; {POINTS} suits this file"
        elif not of_points and name == POINTS:
            unsuited = f"{name} is made for the paper's points; {DEFAULT} suits this file"
        else:
            return
        self.warnings.append(f"{item.source}: {unsuited}")
