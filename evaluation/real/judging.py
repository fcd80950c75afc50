"""From what was opened to measured rows: groups, tuned filters, judged frames."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from ..filters.base import Baseline
from ..methods.method import NOISY, Method
from .groups import (
    LEAST,
    Group,
    Judged,
    Searched,
    alone,
    judged,
    search,
)
from .measure import RealRow, measure, multi_frame_rows
from .settings import RealSettings
from .shots import Shot, Stretch, spread
from .summary import Groups, Summary, summaries
from .tuning import Part, Task, Tuned, parts_of, tuned

TUNED = "tuned on others"
"""Form of the filters' rows."""

_BATCH = 16  # pictures that are in memory at a time
_LEAST_LIMIT = 4
_SEARCH_S = 3600.0  # for a stretch


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was measured.

    shown: number -> picture, of those whose images the rows have.  examples: those to look at.
    best: figure -> label of the filter that is best in it.
    """

    groups: tuple[Group, ...]
    parts: tuple[Part, ...]
    files: tuple[str, ...]
    rows: list[RealRow]
    shown: dict[int, Judged]
    examples: tuple[int, ...]
    member: Groups
    summaries: dict[str, Summary]
    best: dict[str, str]
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
        }


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
    groups: list[Group] = []
    notes: list[str] = []
    shots = [shot for stretch in stretches for shot in stretch.shots]
    if settings.groups == "auto":
        # Whoever marked objects in pictures wants to know of all of them.
        look = all(shot.mask is None for shot in shots)
    else:
        look = settings.groups
    if look:
        found = _searched(stretches, settings.limit, pool)
        groups = [group for one in found for group in one.groups]
        notes = [note for one in found for note in one.notes]
        shots = [shot for one in found for shot in one.shots]
        if not groups:
            notes.append(
                f"no static group was found ({LEAST} frames at least of a scene that stands "
                "still), so there is no truth and nothing to tune filters on"
            )
    parts = parts_of(groups)
    if groups and settings.limit is not None and settings.limit < _LEAST_LIMIT:
        raise FactoryError(
            f"limit={settings.limit}: a static group needs {_LEAST_LIMIT} frames; give more, or "
            "groups=false"
        )
    if groups:
        left = len(shots) - sum(len(group.shots) for group in groups)
        if left:
            notes.append(
                f"{left} other frames are left out (groups=false judges all, without a truth)"
            )
        count = sum(len(part.judged) for part in parts)
        shots = [g.shots[place] for g, p in zip(groups, parts, strict=True) for place in p.judged]
        rows, lost = _rows_of_groups(settings, groups, parts, baselines, simulated, networks, pool)
        notes += _about(groups, parts)
    else:
        shots = spread(shots, settings.limit)
        count = len(shots)
        default = [Method(one.name, "", dict(one.default)) for one in baselines]
        methods = {one.label: one for one in (NOISY, *default, *simulated, *networks)}
        rows, lost = [RealRow(label, (one,)) for label, one in methods.items()], []
    picked = set(
        np.linspace(0, count - 1, min(settings.examples, count)).round().astype(int).tolist()
    )
    with progress_bar(total=count * len(rows), unit="picture", desc="judging") as bar:
        shown = measure(
            _batches(groups, parts, shots, settings.frames),
            rows,
            pool,
            settings.device,
            settings.image_timeout_s,
            picked.__contains__,
            bar.update,
        )
    member = _member(parts, count)
    found_summaries, best = summaries(
        rows, member, resamples=settings.bootstrap, seed=settings.seed
    )
    return Outcome(
        tuple(groups),
        tuple(parts),
        tuple(shot.name for shot in shots),
        [*rows, *lost],
        shown,
        tuple(sorted(picked)),
        member,
        found_summaries,
        best,
        tuple(notes),
    )


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
) -> tuple[list[RealRow], list[RealRow]]:
    """The rows to measure, and those of filters that could not be tuned."""
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
    methods: dict[str, tuple[Method, ...]] = {one.label: (one,) for one in (NOISY, *simulated)}
    for one in filters:
        if one.name not in lost:
            both = tuple(
                Method(one.name, TUNED, point.parameters)
                for _, point in sorted(points[one.name].items())
            )
            methods[both[0].label] = both
    methods |= {one.label: (one,) for one in networks}
    rows = [RealRow(label, both) for label, both in methods.items()]
    return (
        [*rows, *multi_frame_rows(settings.frames)],
        [RealRow(f"{name} {TUNED}", (), lost=why) for name, why in lost.items()],
    )


def _batches(
    groups: Sequence[Group], parts: Sequence[Part], shots: Sequence[Shot], several: int
) -> Iterator[tuple[int, list[Judged]]]:
    for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
        frames = judged(number, group, part.judged, several)
        while some := list(islice(frames, _BATCH)):
            yield part.fold, some
    if not groups:
        for first in range(0, len(shots), _BATCH):
            yield 0, [alone(shot) for shot in shots[first : first + _BATCH]]


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
