"""From what was opened to measured rows: groups, tuned filters, judged frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.errors import FactoryError
from ...factory.files import check_writable
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from ...models.recordings.fan.pings import close_last
from ..filters.base import Baseline
from ..methods.method import NOISY, Method, baselines_of, methods_of
from ..methods.networks import networks_at
from ..runner import Measured, Subject, run
from ..tuning import load_tuned
from .groups import LEAST, Group, Judged, Searched, alone, judged, search
from .measure import MEAN, MEDIAN, RealPicture
from .settings import RealSettings
from .shots import Shot, Stretch, open_input, spread
from .summary import Groups, Summary, summaries
from .time_rows import InTime, judged_in_time
from .tuning import Part, Task, Tuned, parts_of, tuned

TUNED = "tuned on others"
"""Form of the filters' rows."""

_BATCH = 16  # pictures that are in memory at a time
_LEAST_LIMIT = 4
_SEARCH_S = 3600.0  # for a stretch


@dataclass(frozen=True)
class RealRow:
    """A row of the report.

    methods: by fold; one for all folds where it is tuned on nothing.
    lost: why it could not be tuned.
    """

    label: str
    methods: tuple[Method, ...]
    lost: str | None = None

    def method(self, fold: int) -> Method:
        """The one that judges a group of this fold."""
        return self.methods[fold % len(self.methods)]

    @property
    def is_noisy(self) -> bool:
        """Whether this is the picture as it is."""
        return bool(self.methods) and self.methods[0].is_noisy

    @property
    def is_network(self) -> bool:
        """Whether trained weights made it."""
        return bool(self.methods) and self.methods[0].weights is not None

    @property
    def of_several(self) -> bool:
        """Whether several frames made it, so that it has another reference."""
        return bool(self.methods) and bool(self.methods[0].given)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was measured.

    shown: number -> picture to look at, of those whose images are in `measured`.
    best: figure -> label of the filter that is best in it.
    """

    groups: tuple[Group, ...]
    parts: tuple[Part, ...]
    files: tuple[str, ...]
    rows: list[RealRow]
    measured: Measured
    shown: dict[int, Judged]
    summaries: dict[str, Summary]
    best: dict[str, str]
    in_time: InTime
    notes: tuple[str, ...]

    def facts(self) -> dict[str, Any]:
        """For real.json."""
        return {
            "files": list(self.files),
            "groups": [
                {
                    "name": group.name,
                    "frames": [shot.name for shot in group.shots],
                    "judged": [group.shots[place].name for place in part.judged],
                    "fold": part.fold,
                    "largest_shift_px": float(np.hypot(*group.shifts_px.T).max()),
                    "judged_share_of_sector": group.still,
                    "geometry": "unknown" if group.geometry is None else group.geometry.layout,
                }
                for group, part in zip(self.groups, self.parts, strict=True)
            ],
            "best_filter": self.best,
            "in_time": self.in_time.facts(),
        }


def evaluate(settings: RealSettings) -> None:
    """Measure, print the table and write the report.  Raises FactoryError."""
    from . import report

    if settings.tuned is not None and not Path(settings.tuned).is_file():
        raise FactoryError(f"tuned={settings.tuned}: no such file; `evaluation tune` writes one")
    tuned_before = None if settings.tuned is None else load_tuned(Path(settings.tuned))
    baselines = baselines_of(settings.baselines)
    simulated = [] if tuned_before is None else methods_of(baselines, tuned_before)
    networks = networks_at(settings.models, {})
    stretches, notes = open_input(settings.real, settings.search)
    out = settings.folder
    check_writable(out, "out")
    with TaskPool(settings.workers) as pool:
        outcome = judge(settings, stretches, baselines, simulated, networks, pool)
    facts: dict[str, Any] = {
        "schema": "simnfnd-real/2",
        "name": Path(settings.real).expanduser().resolve().name,
        **outcome.facts(),
        "notes": [*notes, *outcome.notes],
    }
    report.write(out, facts, outcome)
    close_last()
    print(report.terminal(out))
    print(f"report: {out / 'real.html'}")


def judge(
    settings: RealSettings,
    stretches: Sequence[Stretch],
    baselines: Sequence[Baseline],
    simulated: Sequence[Method],
    networks: Sequence[Method],
    pool: TaskPool,
) -> Outcome:
    """Find static groups, tune the filters, and measure every row.

    simulated: rows of filters whose parameters are known; networks: those of weights.
    FactoryError when something cannot be read, or there is nothing to judge.
    """
    groups, shots, notes = _found(settings, stretches, pool)
    parts = parts_of(groups)
    if groups:
        notes += _about(groups, parts)
        shots = [g.shots[place] for g, p in zip(groups, parts, strict=True) for place in p.judged]
        rows = _rows_of_groups(settings, groups, parts, baselines, simulated, networks, pool)
    else:
        shots = spread(shots, settings.limit)
        default = [Method(one.name, "", dict(one.default)) for one in baselines]
        methods = {one.label: one for one in (NOISY, *default, *simulated, *networks)}
        rows = [RealRow(label, (one,)) for label, one in methods.items()]
    count = len(shots)
    picked = np.linspace(0, count - 1, min(settings.examples, count)).round().astype(int)
    measured, shown = _measured(settings, groups, parts, shots, rows, set(picked.tolist()), pool)
    member = _member(parts, count)
    found, best = summaries(
        rows, measured, member, resamples=settings.bootstrap, seed=settings.seed
    )
    in_time = judged_in_time(settings, groups, networks, pool)
    return Outcome(
        tuple(groups),
        tuple(parts),
        tuple(shot.name for shot in shots),
        rows,
        measured,
        shown,
        found,
        best,
        in_time,
        (*notes, *in_time.notes),
    )


def _found(
    settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool
) -> tuple[list[Group], list[Shot], list[str]]:
    """Static groups, where they are looked for; all shots that can be read; and notes."""
    shots = [shot for stretch in stretches for shot in stretch.shots]
    look = settings.groups
    if look == "auto":
        # Whoever marked objects in pictures wants to know of all of them.
        look = all(shot.mask is None for shot in shots)
    if not look:
        return [], shots, []
    found = _searched(stretches, settings.limit, pool)
    groups = [group for one in found for group in one.groups]
    notes = [note for one in found for note in one.notes]
    shots = [shot for one in found for shot in one.shots]
    if not groups:
        notes.append(
            f"no static group was found ({LEAST} frames at least of a scene that stands still), "
            "so there is no truth and nothing to tune filters on"
        )
    elif settings.limit is not None and settings.limit < _LEAST_LIMIT:
        raise FactoryError(
            f"limit={settings.limit}: a static group needs {_LEAST_LIMIT} frames; give more, or "
            "groups=false"
        )
    elif left := len(shots) - sum(len(group.shots) for group in groups):
        notes.append(f"{left} other frames are left out (groups=false judges all, without a truth)")
    return groups, shots, notes


def _searched(stretches: Sequence[Stretch], limit: int | None, pool: TaskPool) -> list[Searched]:
    waiting = deque((number, one, limit) for number, one in enumerate(stretches))
    found: dict[int, Searched] = {}
    with progress_bar(total=len(waiting), unit="folder", desc="static groups") as bar:
        for (number, stretch, _), one in pool.run(search, waiting, lambda _: _SEARCH_S):
            bar.update()
            if isinstance(one, TaskLost):
                one = Searched([], [], [f"{stretch.name}: lost ({one.reason})"])
            found[number] = one
    return [one for _, one in sorted(found.items())]


def _rows_of_groups(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[Part],
    baselines: Sequence[Baseline],
    simulated: Sequence[Method],
    networks: Sequence[Method],
    pool: TaskPool,
) -> list[RealRow]:
    """The rows to measure; filters that could not be tuned come last."""
    filters = [one for one in baselines if one.grid]
    frames: dict[int, list[Judged]] = {}
    for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
        for fold, places in part.tuning.items():
            frames.setdefault(fold, []).extend(judged(number, group, places, 0))
    waiting = deque(
        Task(one.name, fold, tuple(own)) for one in filters for fold, own in sorted(frames.items())
    )
    points: dict[str, dict[int, Tuned]] = {one.name: {} for one in filters}
    lost: dict[str, str] = {}
    longest_s = settings.image_timeout_s * max(map(len, frames.values()))
    with progress_bar(total=len(waiting), unit="filter", desc="tuning") as bar:
        for task, found in pool.run(tuned, waiting, lambda _: longest_s):
            bar.update()
            if isinstance(found, Tuned):
                points[task.baseline][task.fold] = found
            else:
                why = found.reason if isinstance(found, TaskLost) else found
                lost.setdefault(task.baseline, f"tuning: {why}")
    rows = {one.label: RealRow(one.label, (one,)) for one in (NOISY, *simulated)}
    for one in filters:
        if one.name not in lost:
            by_fold = [point.parameters for _, point in sorted(points[one.name].items())]
            row = tuple(Method(one.name, TUNED, parameters) for parameters in by_fold)
            rows[row[0].label] = RealRow(row[0].label, row)
    rows |= {one.label: RealRow(one.label, (one,)) for one in networks}
    for what in (MEAN, MEDIAN):
        several = Method(f"multi-frame {what} ({settings.frames})", "", {}, given=what)
        rows[several.label] = RealRow(several.label, (several,))
    return [
        *rows.values(),
        *(RealRow(f"{name} {TUNED}", (), lost=why) for name, why in lost.items()),
    ]


@dataclass(eq=False)
class _Pictures:
    """What is judged of a fold, batch after batch; keeps the pictures that are shown."""

    fold: int
    groups: Sequence[Group]
    parts: Sequence[Part]
    shots: Sequence[Shot]
    several: int
    picked: set[int]
    shown: dict[int, Judged] = field(default_factory=dict)

    def __iter__(self) -> Iterator[dict[int, Subject]]:
        first = 0
        for number, (group, part) in enumerate(zip(self.groups, self.parts, strict=True)):
            if part.fold == self.fold:
                frames = judged(number, group, part.judged, self.several)
                yield from self._batches(first, frames)
            first += len(part.judged)
        if not self.groups:
            yield from self._batches(0, map(alone, self.shots))

    def _batches(self, first: int, frames: Iterator[Judged]) -> Iterator[dict[int, Subject]]:
        numbered = enumerate(frames, start=first)
        while some := dict(islice(numbered, _BATCH)):
            self.shown |= {number: one for number, one in some.items() if number in self.picked}
            yield {number: RealPicture(one) for number, one in some.items()}


def _measured(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[Part],
    shots: Sequence[Shot],
    rows: Sequence[RealRow],
    picked: set[int],
    pool: TaskPool,
) -> tuple[Measured, dict[int, Judged]]:
    """Every row on every picture, fold after fold; and number -> picture of those to look at."""
    alive = [row for row in rows if row.lost is None]
    every = Measured()
    shown: dict[int, Judged] = {}
    with progress_bar(total=len(shots) * len(alive), unit="picture", desc="judging") as bar:
        for fold in sorted({part.fold for part in parts}) or [0]:
            pictures = _Pictures(fold, groups, parts, shots, settings.frames, picked)
            found = run(
                [row.method(fold) for row in alive],
                pictures,
                pool,
                device=settings.device,
                timeout_s=settings.image_timeout_s,
                keep=picked.__contains__,
                tick=bar.update,
            )
            for label, figures in found.figures.items():
                every.figures.setdefault(label, {}).update(figures)
            every.lost = {**found.lost, **every.lost}
            every.images |= found.images
            shown |= pictures.shown
    for label, figures in every.figures.items():
        if not figures:
            why = "too few frames of every group are left for a reference"
            every.lost.setdefault(label, why)
    every.lost |= {row.label: row.lost for row in rows if row.lost is not None}
    return every, shown


def _member(parts: Sequence[Part], count: int) -> Groups:
    if not parts:
        return Groups(False, tuple(map(str, range(count))), np.arange(count))
    sizes = [len(part.judged) for part in parts]
    return Groups(True, tuple(map(str, range(len(parts)))), np.repeat(np.arange(len(sizes)), sizes))


def _about(groups: Sequence[Group], parts: Sequence[Part]) -> list[str]:
    frames = sum(len(group.shots) for group in groups)
    text = [f"{len(groups)} static groups of {frames} frames in all"]
    if len(groups) == 1:
        first, second = len(groups[0].shots) - len(parts[0].judged), len(parts[0].judged)
        text = [
            f"one static group of {frames} frames: filters are tuned on frames of its first half "
            f"({first}) and all rows judged on its second half ({second}), so there are no "
            "intervals"
        ]
    still = min(group.still for group in groups)
    if still < 1:
        text.append(f"what moves is left out, at most {1 - still:.1%} of a sector")
    largest = max(float(np.hypot(*group.shifts_px.T).max()) for group in groups)
    text.append(f"frames lie at most {largest:.1f} pixels from that in the middle, which is undone")
    return text
