"""From what was opened to rows over groups: static groups, tuned filters, judged frames, means."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from ..filters.base import Baseline, Parameters
from ..methods import NOISY, Method, baselines_of, networks_at
from ..metrics.statistics import estimate, evenly
from ..runner import SECONDS, Measured, Subject, run
from ..settings import RealSettings
from .groups import LEAST, Group, Judged, Searched, alone, judged, search
from .in_time import judged_in_time
from .measure import RealPicture
from .shots import Shot, Stretch
from .tuning import Part, Task, parts_of, tuned

if TYPE_CHECKING:
    import pandas as pd

TUNED = "tuned on others"
"""Form of the filters' rows."""
MARGINS = {"psnr_db": "margin_db", "ssim": "margin_ssim"}
"""Figure -> name of what a row has more of it than the best filter."""

_BATCH = 16  # pictures that are in memory at a time
_SEARCH_S = 3600.0  # for a stretch


@dataclass(frozen=True)
class RealRow:
    """A row of the report.

    methods: by fold; one for all folds where it is tuned on nothing, none where it is lost.
    lost: why it could not be tuned.
    """

    label: str
    methods: tuple[Method, ...]
    lost: str | None = None

    @property
    def kind(self) -> str:
        """See `Method.kind`."""
        return self.methods[0].kind if self.methods else "baseline"


@dataclass(frozen=True)
class Summary:
    """A row over all groups.

    means, intervals: figure -> mean over the groups and its 95 % interval, which there is of two
    static groups at least.
    groups: figure -> (groups,) mean of each group, NaN where there is none.
    cpu_s, among the means, is the median over the pictures, because the first loads and compiles.
    unchanged, pictures: how many pictures came back as they were, of how many.
    """

    means: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    groups: dict[str, npt.NDArray[np.float64]]
    unchanged: int
    pictures: int


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was measured.

    files: names of the pictures.  shown: number -> picture to look at, of those whose images are in
    `measured`.  best: figure -> label of the filter that is best in it.
    """

    groups: list[Group]
    parts: list[Part]
    files: list[str]
    rows: list[RealRow]
    measured: Measured
    shown: dict[int, Judged]
    summaries: dict[str, Summary]
    best: dict[str, str]
    in_time: pd.DataFrame
    notes: list[str]


def judge(settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool) -> Outcome:
    """Find static groups, tune the filters, and measure every row.

    FactoryError when something cannot be read, or there is nothing to judge.
    """
    baselines = baselines_of(settings.baselines)
    networks = networks_at(settings.models)
    groups, shots, notes = _found(settings, stretches, pool)
    parts = parts_of(groups)
    if groups:
        notes += _about(groups, parts)
        shots = [g.shots[place] for g, p in zip(groups, parts, strict=True) for place in p.judged]
        rows = _rows_of_groups(settings, groups, parts, baselines, networks, pool)
        member = np.repeat(np.arange(len(parts)), [len(part.judged) for part in parts])
    else:
        shots = evenly(shots, settings.limit)
        default = [Method(one.name, "", dict(one.default)) for one in baselines]
        methods = {one.label: one for one in (NOISY, *default, *networks)}
        rows = [RealRow(label, (one,)) for label, one in methods.items()]
        member = np.arange(len(shots))  # every picture is a group
    places = np.linspace(0, len(shots) - 1, min(settings.examples, len(shots)))
    picked = set(places.round().astype(int).tolist())
    measured, shown = _measured(settings, groups, parts, shots, rows, picked, pool)
    found, best = summaries(
        rows, measured, member, bool(groups), resamples=settings.bootstrap, seed=settings.seed
    )
    in_time, more = judged_in_time(settings, groups, networks, pool)
    files = [shot.name for shot in shots]
    notes += more
    return Outcome(groups, parts, files, rows, measured, shown, found, best, in_time, notes)


def _found(
    settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool
) -> tuple[list[Group], list[Shot], list[str]]:
    """Static groups, where they are looked for; all shots that can be read; and notes."""
    if not settings.groups:
        return [], [shot for stretch in stretches for shot in stretch.shots], []
    waiting = deque((number, one, settings.limit) for number, one in enumerate(stretches))
    searched: dict[int, Searched] = {}
    with progress_bar(total=len(waiting), unit="folder", desc="static groups") as bar:
        for (number, stretch, _), one in pool.run(search, waiting, lambda _: _SEARCH_S):
            bar.update()
            if isinstance(one, TaskLost):
                one = Searched([], [], [f"{stretch.name}: lost ({one.reason})"])
            searched[number] = one
    found = [one for _, one in sorted(searched.items())]
    groups = [group for one in found for group in one.groups]
    notes = [note for one in found for note in one.notes]
    shots = [shot for one in found for shot in one.shots]
    if not groups:
        notes.append(
            f"no static group was found ({LEAST} frames at least of a scene that stands still), "
            "so there is no truth and nothing to tune filters on"
        )
    elif left := len(shots) - sum(len(group.shots) for group in groups):
        notes.append(f"{left} other frames are left out (groups=false judges all, without a truth)")
    return groups, shots, notes


def _rows_of_groups(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[Part],
    baselines: Sequence[Baseline],
    networks: Sequence[Method],
    pool: TaskPool,
) -> list[RealRow]:
    """The rows to measure; filters that could not be tuned come last."""
    filters = [one.name for one in baselines if one.grid]
    frames: dict[int, list[Judged]] = {}
    for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
        for fold, places in part.tuning.items():
            frames.setdefault(fold, []).extend(judged(number, group, places))
    waiting = deque(
        Task(f, fold, tuple(own)) for f in filters for fold, own in sorted(frames.items())
    )
    points: dict[str, dict[int, Parameters]] = {name: {} for name in filters}
    lost: dict[str, str] = {}
    longest_s = settings.image_timeout_s * max(map(len, frames.values()))
    with progress_bar(total=len(waiting), unit="filter", desc="tuning") as bar:
        for task, found in pool.run(tuned, waiting, lambda _: longest_s):
            bar.update()
            if isinstance(found, dict):
                points[task.baseline][task.fold] = found
            else:
                why = found.reason if isinstance(found, TaskLost) else found
                lost.setdefault(task.baseline, f"tuning: {why}")
    alive: list[tuple[Method, ...]] = [(NOISY,)]
    for name in filters:
        if name not in lost:
            alive.append(tuple(Method(name, TUNED, own) for _, own in sorted(points[name].items())))
    alive += [(one,) for one in networks]
    rows = [RealRow(methods[0].label, methods) for methods in alive]
    return [*rows, *(RealRow(f"{name} {TUNED}", (), why) for name, why in lost.items())]


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
    every = Measured(lost={row.label: row.lost for row in rows if row.lost is not None})
    shown: dict[int, Judged] = {}

    def pictures(fold: int) -> Iterator[tuple[int, Judged]]:
        first = 0
        for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
            if part.fold == fold:
                yield from enumerate(judged(number, group, part.judged), first)
            first += len(part.judged)
        if not groups:
            yield from enumerate(map(alone, shots))

    def batches(fold: int) -> Iterator[dict[int, Subject]]:
        left = pictures(fold)
        while some := dict(islice(left, _BATCH)):
            shown.update({number: one for number, one in some.items() if number in picked})
            yield {number: RealPicture(one) for number, one in some.items()}

    with progress_bar(total=len(shots) * len(alive), unit="picture", desc="judging") as bar:
        for fold in sorted({part.fold for part in parts}) or [0]:
            found = run(
                [row.methods[fold % len(row.methods)] for row in alive],
                batches(fold),
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
    return every, shown


def summaries(
    rows: Sequence[RealRow],
    measured: Measured,
    member: npt.NDArray[np.int64],
    static: bool,
    *,
    resamples: int,
    seed: int,
) -> tuple[dict[str, Summary], dict[str, str]]:
    """Label -> summary of each row that is not lost; figure -> label of the best filter in it.

    member: (N,) group of each judged picture.  static: whether these are scenes at rest.
    """
    table = measured.table().replace([np.inf, -np.inf], np.nan)
    table["group"] = member[table["picture"].to_numpy(int)]
    names = [str(number) for number in range(int(member.max(initial=-1)) + 1)]
    by_group = table.drop(columns="picture").groupby(["method", "group"], sort=False).mean()
    over = by_group.groupby("method", sort=False).mean()
    alive = [row for row in rows if row.label in over.index]
    filters = [row.label for row in alive if row.kind == "baseline"]
    best = {
        name: str(over.loc[filters, name].idxmax()) for name in MARGINS if filters and name in over
    }
    found = {}
    for row in alive:
        own = cast("pd.DataFrame", by_group.loc[row.label]).reindex(range(len(names)))
        for name, label in best.items():
            if row.label != label:
                own[MARGINS[name]] = own[name] - by_group.loc[label][name]
        own = own.drop(columns=SECONDS).dropna(axis="columns", how="all")
        values = {str(name): own[name].to_numpy(float) for name in own}
        known = {
            n: estimate(one, names, resamples=resamples, seed=seed) for n, one in values.items()
        }
        pictures = table[table["method"] == row.label]
        means = {name: one.mean for name, one in known.items()}
        means[SECONDS] = float(pictures[SECONDS].median())
        intervals = {n: (e.low, e.high) for n, e in known.items() if static and e.count > 1}
        unchanged = int((pictures["unchanged"] > 0).sum())
        found[row.label] = Summary(means, intervals, values, unchanged, len(pictures))
    return found, best


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
    largest = max(group.largest_px for group in groups)
    text.append(f"frames lie at most {largest:.1f} pixels from that in the middle, which is undone")
    return text
