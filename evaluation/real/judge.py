"""Real images judged: static groups are found, filters tuned, images measured, rows averaged."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from ...factory.common.progress import Bar
from ...factory.common.workers.tasks import TaskLost, TaskPool
from ..filters import Baseline
from ..judging import tuning
from ..judging.learned import learned_notes
from ..judging.methods import NOISY, Method, baselines_of, networks_at
from ..judging.pairs import given_methods
from ..judging.recorded import RecordedImage, Stretch
from ..judging.runner import Measured, Subject, run
from ..judging.settings import RealSettings
from ..metrics.statistics import evenly
from ..report.content import Estimator, compare_rows, rows_of
from .groups import LEAST, Group, GroupPart, JudgedFrame, Searched, alone, judged, parts_of, search
from .in_time import Judgement, judged_in_time

TUNED = "tuned on others"
"""Form of the filters' methods."""

_BATCH_IMAGES = 16  # images that are in memory at a time
_SEARCH_S = 3600.0  # longest search for groups in a stretch


@dataclass(frozen=True, eq=False)
class RealOutcome:
    """The figures of all rows on all images.

    rows: as `report.content.rows_of` gives them; `against_best` is the margin over the best filter.
    shots: the judged images.  examples: number -> image, of those that the report shows;
    what the methods made of them is in `measured`.  best: figure -> label of the best filter in it.
    """

    groups: list[Group]
    parts: list[GroupPart]
    shots: list[RecordedImage]
    rows: list[dict[str, Any]]
    measured: Measured
    examples: dict[int, JudgedFrame]
    best: dict[str, str]
    in_time: Judgement
    notes: list[str]


def judge(settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool) -> RealOutcome:
    """Find static groups, tune the filters, and measure every method.

    Raises FactoryError when something cannot be read, or there is nothing to judge.
    """
    baselines = baselines_of(settings.baselines)
    networks = networks_at(settings.models)
    warnings = learned_notes(stretches, networks)
    groups, shots, notes = _search_groups(settings, stretches, pool)
    parts = parts_of(groups)
    lost: dict[str, str] = {}
    if groups:
        notes += _group_notes(groups, parts)
        filters, lost = _tune_filters(settings, groups, parts, baselines, pool)
        shots = [
            group.shots[place]
            for group, part in zip(groups, parts, strict=True)
            for place in part.judged
        ]
        group_of_image = np.repeat(range(len(parts)), [len(part.judged) for part in parts])
    else:
        shots = evenly(shots, settings.limit)
        filters = [Method(baseline.name, "", dict(baseline.default)) for baseline in baselines]
        group_of_image = np.arange(len(shots))
    given = given_methods(settings.pictures, [shot.names() for shot in shots])
    methods = [NOISY, *filters, *networks, *given]
    measured, examples = _measure(settings, groups, parts, shots, methods, lost, pool)

    figures = measured.wide(group_of_image.tolist())
    # Images that belong to no static group have no intervals.
    names = [str(number) if groups else "" for number in sorted(set(group_of_image.tolist()))]
    estimator = Estimator(figures, names, settings.bootstrap, settings.seed)
    rows = rows_of(methods, measured, estimator)
    best = _best_filters(rows)
    compare_rows(
        rows, "against_best", ("noisy", "baseline", "network", "pictures"), best, estimator
    )
    in_time = judged_in_time(settings, groups, networks, pool)
    notes = [*warnings, *notes, *in_time.notes]
    return RealOutcome(groups, parts, shots, rows, measured, examples, best, in_time, notes)


def _search_groups(
    settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool
) -> Searched:
    """Static groups, readable shots and notes of all stretches; no groups with `groups=false`."""
    if not settings.groups:
        return Searched([], [shot for stretch in stretches for shot in stretch.shots], [])
    waiting = deque((number, stretch, settings.limit) for number, stretch in enumerate(stretches))
    searched: dict[int, Searched] = {}
    with Bar(total=len(waiting), unit="folder", desc="static groups") as bar:
        for (number, stretch, _), stretch_result in pool.run(search, waiting, lambda _: _SEARCH_S):
            bar.update()
            if isinstance(stretch_result, TaskLost):
                note = f"{stretch.name}: lost ({stretch_result.reason})"
                searched[number] = Searched([], [], [note])
            else:
                searched[number] = stretch_result

    groups: list[Group] = []
    shots: list[RecordedImage] = []
    notes: list[str] = []
    for _, stretch_result in sorted(searched.items()):
        groups += stretch_result.groups
        shots += stretch_result.shots
        notes += stretch_result.notes
    left_out = len(shots) - sum(len(group.shots) for group in groups)
    if not groups:
        notes.append(
            f"no static group was found ({LEAST} frames at least of a static scene), "
            "so there is no truth and nothing to tune filters on"
        )
    elif left_out:
        notes.append(
            f"{left_out} other frames are left out (groups=false judges all, without a truth)"
        )
    return Searched(groups, shots, notes)


def _tune_filters(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[GroupPart],
    baselines: Sequence[Baseline],
    pool: TaskPool,
) -> tuple[list[Method], dict[str, str]]:
    """The filters, each with parameters for every fold; and label -> why one has none."""
    samples_of_fold: dict[int, list[tuning.TuningImage]] = {}
    for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
        for fold, places in part.tuning.items():
            samples_of_fold.setdefault(fold, []).extend(
                tuning.TuningImage(frame.noisy, frame.reference, frame.mask)
                for frame in judged(number, group, places)
                if frame.reference is not None
            )

    filters = [baseline.name for baseline in baselines if baseline.grid]
    tasks = [
        tuning.TuningTask(name, tuple(samples), fold)
        for name in filters
        for fold, samples in sorted(samples_of_fold.items())
    ]
    points: dict[tuple[str, int], dict[str, Any]] = {}
    lost: dict[str, str] = {}
    for task, tuned in tuning.run_tasks(tuning.on_frames, tasks, pool, settings.image_timeout_s):
        if isinstance(tuned, str):
            lost.setdefault(f"{task.baseline} {TUNED}", f"tuning: {tuned}")
        else:
            points[task.baseline, task.fold] = tuned
    folds = sorted(samples_of_fold)
    methods = [
        Method(name, TUNED, {}, folds=tuple(points.get((name, fold), {}) for fold in folds))
        for name in filters
    ]
    return methods, lost


def _measure(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[GroupPart],
    shots: Sequence[RecordedImage],
    methods: Sequence[Method],
    lost: dict[str, str],
    pool: TaskPool,
) -> tuple[Measured, dict[int, JudgedFrame]]:
    """Every method on every image; and number -> image of the examples.

    lost: label -> why a method cannot run.
    """
    shown = set(evenly(range(len(shots)), settings.examples))
    examples: dict[int, JudgedFrame] = {}
    images = enumerate(_judged_frames(groups, parts, shots))

    def batches() -> Iterator[dict[int, Subject]]:
        while batch := dict(islice(images, _BATCH_IMAGES)):
            examples.update({number: batch[number] for number in shown & batch.keys()})
            yield dict(batch)

    alive = [method for method in methods if method.label not in lost]
    with Bar(total=len(shots) * len(alive), unit="image", desc="judging") as bar:
        measured = run(
            alive,
            batches(),
            pool,
            device=settings.device,
            timeout_s=settings.image_timeout_s,
            keep=shown.__contains__,
            tick=bar.update,
        )
    measured.lost |= lost
    return measured, examples


def _judged_frames(
    groups: Sequence[Group], parts: Sequence[GroupPart], shots: Sequence[RecordedImage]
) -> Iterator[JudgedFrame]:
    """All that is judged; without groups these are all shots."""
    if not groups:
        yield from map(alone, shots)
    for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
        yield from judged(number, group, part.judged, part.fold)


def _best_filters(rows: Sequence[dict[str, Any]]) -> dict[str, str]:
    """Metric -> label of the filter with the greatest mean over the groups."""
    filters = [row for row in rows if row["kind"] == "baseline" and row["lost"] is None]
    return {
        name: max(filters, key=lambda row: row["metrics"][name]["mean"])["label"]
        for name in ("psnr", "ssim")
        if filters and name in filters[0]["metrics"]
    }


def _group_notes(groups: Sequence[Group], parts: Sequence[GroupPart]) -> list[str]:
    """What the report says of the static groups."""
    frame_count = sum(len(group.shots) for group in groups)
    notes = [f"{len(groups)} static groups of {frame_count} frames in all"]
    if len(groups) == 1:
        judged_count = len(parts[0].judged)
        notes = [
            "one static group: filters are tuned on frames of its first half "
            f"({frame_count - judged_count}) and all rows judged on its second half "
            f"({judged_count}), so there are no intervals"
        ]
    least_static_share = min(group.still for group in groups)
    if least_static_share < 1:
        moving_share = 1 - least_static_share
        notes.append(f"moving objects are left out, at most {moving_share:.1%} of a sector")
    largest_px = max(group.largest_px for group in groups)
    notes.append(
        f"frames lie at most {largest_px:.1f} pixels from that in the middle, which is undone"
    )
    return notes
