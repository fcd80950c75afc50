"""From what was opened to rows over groups: static groups, tuned filters, judged frames, means."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, Any, cast

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.scheduler.workers.tasks import TaskLost, TaskPool
from .. import tuning
from ..filters import Baseline, Parameters
from ..learned import learned_notes
from ..methods import NOISY, Method, baselines_of, networks_at
from ..metrics.fidelity import Mask, edge_preservation, finite_psnr, psnr, ssim
from ..metrics.measure import (
    SIDE,
    Figures,
    Grey,
    contrast_to_noise,
    enl,
    fit_levels,
    homogeneous_zones,
    ratio_figures,
)
from ..metrics.statistics import estimate, evenly
from ..recorded import Shot, Stretch
from ..report.tables import plain
from ..runner import SECONDS, Measured, Subject, run
from ..settings import RealSettings
from .groups import LEAST, Group, Judged, Part, Searched, alone, judged, parts_of, search
from .in_time import judged_in_time

if TYPE_CHECKING:
    import pandas as pd

    from ...factory.sonar.geometry import FanGeometry

TUNED = "tuned on others"
"""Form of the filters' rows."""
MARGINS = {"psnr_db": "margin_db", "ssim": "margin_ssim"}
"""Figure -> name of what a row has more of it than the best filter."""

_BATCH = 16  # images that are in memory at a time
_SEARCH_S = 3600.0  # for a stretch

Row = dict[str, Any]
"""A row of the report as plain data, see `rows_of`."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What was measured.

    files: names of the images.  shown: number -> image to look at, of those whose images are in
    `measured`.  best: figure -> label of the filter that is best in it.
    """

    groups: list[Group]
    parts: list[Part]
    files: list[str]
    rows: list[Row]
    measured: Measured
    shown: dict[int, Judged]
    best: dict[str, str]
    in_time: pd.DataFrame
    notes: list[str]


def judge(settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool) -> Outcome:
    """Find static groups, tune the filters, and measure every row.

    FactoryError when something cannot be read, or there is nothing to judge.
    """
    baselines = baselines_of(settings.baselines)
    networks = networks_at(settings.models)
    warnings = learned_notes(stretches, networks)
    groups, shots, notes = _search_groups(settings, stretches, pool)
    parts = parts_of(groups)
    lost: dict[str, str] = {}
    if groups:
        notes += _about(groups, parts)
        shots = [g.shots[place] for g, p in zip(groups, parts, strict=True) for place in p.judged]
        points, lost = _tuned(settings, groups, parts, baselines, pool)
        filters = [
            tuple(Method(name, TUNED, point) for _, point in sorted(point_of_fold.items()))
            for name, point_of_fold in points.items()
        ]
        member = np.repeat(np.arange(len(parts)), [len(part.judged) for part in parts])
    else:
        shots = evenly(shots, settings.limit)
        filters = [(Method(method.name, "", dict(method.default)),) for method in baselines]
        member = np.arange(len(shots))  # every image is a group
    every = [(NOISY,), *filters, *((method,) for method in networks)]
    methods = {folds[0].label: folds for folds in every}
    places = np.linspace(0, len(shots) - 1, min(settings.examples, len(shots)))
    picked = set(places.round().astype(int).tolist())
    measured, shown = _measured(settings, groups, parts, shots, methods, picked, pool)
    measured.lost |= lost
    methods |= dict.fromkeys(lost, ())
    rows, best = rows_of(
        methods, measured, member, bool(groups), resamples=settings.bootstrap, seed=settings.seed
    )
    in_time, more = judged_in_time(settings, groups, networks, pool)
    files = [shot.name for shot in shots]
    notes = [*warnings, *notes, *more]
    return Outcome(groups, parts, files, rows, measured, shown, best, in_time, notes)


def _search_groups(
    settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool
) -> tuple[list[Group], list[Shot], list[str]]:
    """Static groups, where they are looked for; all shots that can be read; and notes."""
    if not settings.groups:
        return [], [shot for stretch in stretches for shot in stretch.shots], []
    waiting = deque((number, outcome, settings.limit) for number, outcome in enumerate(stretches))
    searched: dict[int, Searched] = {}
    with progress_bar(total=len(waiting), unit="folder", desc="static groups") as bar:
        for (number, stretch, _), outcome in pool.run(search, waiting, lambda _: _SEARCH_S):
            bar.update()
            if isinstance(outcome, TaskLost):
                outcome = [], [], [f"{stretch.name}: lost ({outcome.reason})"]
            searched[number] = outcome
    groups = list[Group]()
    shots = list[Shot]()
    notes = list[str]()
    for _, (stretch_groups, stretch_shots, stretch_notes) in sorted(searched.items()):
        groups += stretch_groups
        shots += stretch_shots
        notes += stretch_notes
    if not groups:
        notes.append(
            f"no static group was found ({LEAST} frames at least of a static scene), "
            "so there is no truth and nothing to tune filters on"
        )
    elif left := len(shots) - sum(len(group.shots) for group in groups):
        notes.append(f"{left} other frames are left out (groups=false judges all, without a truth)")
    return groups, shots, notes


def _tuned(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[Part],
    baselines: Sequence[Baseline],
    pool: TaskPool,
) -> tuple[dict[str, dict[int, Parameters]], dict[str, str]]:
    """Filter -> fold -> parameters; and label -> why a filter could not be tuned."""
    filters = [baseline.name for baseline in baselines if baseline.grid]
    samples: dict[int, list[tuning.Sample]] = {}
    for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
        for fold, places in part.tuning.items():
            samples.setdefault(fold, []).extend(
                tuning.Sample(baseline.noisy, baseline.reference, baseline.mask)
                for baseline in judged(number, group, places)
                if baseline.reference is not None
            )
    folds = sorted(samples.items())
    tasks = [tuning.Task(name, tuple(own), fold) for name in filters for fold, own in folds]
    points: dict[str, dict[int, Parameters]] = {name: {} for name in filters}
    lost: dict[str, str] = {}
    longest_s = settings.image_timeout_s * max(map(len, samples.values()))
    for task, outcome in tuning.run_tasks(tuning.on_frames, tasks, pool, lambda _: longest_s):
        if isinstance(outcome, str):
            lost.setdefault(f"{task.baseline} {TUNED}", f"tuning: {outcome}")
            points.pop(task.baseline, None)
        elif task.baseline in points:
            points[task.baseline][task.fold] = outcome
    return points, lost


def _measured(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[Part],
    shots: Sequence[Shot],
    methods: Mapping[str, Sequence[Method]],
    picked: set[int],
    pool: TaskPool,
) -> tuple[Measured, dict[int, Judged]]:
    """Every row on every image, fold after fold; and number -> image of those to look at."""
    every = Measured()
    shown = dict[int, Judged]()

    def images(fold: int) -> Iterator[tuple[int, Judged]]:
        first = 0
        for number, (group, part) in enumerate(zip(groups, parts, strict=True)):
            if part.fold == fold:
                yield from enumerate(judged(number, group, part.judged), first)
            first += len(part.judged)
        if not groups:
            yield from enumerate(map(alone, shots))

    def batches(fold: int) -> Iterator[dict[int, Subject]]:
        left = images(fold)
        while some := dict(islice(left, _BATCH)):
            shown.update({number: frame for number, frame in some.items() if number in picked})
            yield {number: RealImage(frame) for number, frame in some.items()}

    with progress_bar(total=len(shots) * len(methods), unit="image", desc="judging") as bar:
        for fold in sorted({part.fold for part in parts}) or [0]:
            measured = run(
                [folds[fold % len(folds)] for folds in methods.values()],
                batches(fold),
                pool,
                device=settings.device,
                timeout_s=settings.image_timeout_s,
                keep=picked.__contains__,
                tick=bar.update,
            )
            for label, figures in measured.figures.items():
                every.figures.setdefault(label, {}).update(figures)
            every.lost = {**measured.lost, **every.lost}
            every.images |= measured.images
    return every, shown


def rows_of(
    methods: Mapping[str, Sequence[Method]],
    measured: Measured,
    member: npt.NDArray[np.int64],
    static: bool,
    *,
    resamples: int,
    seed: int,
) -> tuple[list[Row], dict[str, str]]:
    """The rows as plain data; and figure -> label of the best filter in it.

    methods: label -> of each fold; one for all folds where it is tuned on nothing, none where it is
    lost.  member: (N,) group of each judged image.  static: whether these are scenes at rest.
    means, intervals: figure -> mean over the groups and its 95 % interval, which there is of two
    static groups at least; seconds are the median over the images, because the first loads and
    compiles.  by_group: figure -> mean of each group.
    """
    table = measured.table().replace([np.inf, -np.inf], np.nan)
    table["group"] = member[table["picture"].to_numpy(int)]
    count = int(member.max(initial=-1)) + 1
    names = [str(number) for number in range(count)]
    by_group = table.drop(columns="picture").groupby(["method", "group"], sort=False).mean()
    over = by_group.groupby("method", sort=False).mean()
    kinds = {label: folds[0].kind for label, folds in methods.items() if label in over.index}
    filters = [label for label, kind in kinds.items() if kind == "baseline"]
    best = {
        name: str(over.loc[filters, name].idxmax()) for name in MARGINS if filters and name in over
    }
    rows = []
    for label, folds in methods.items():
        row: Row = {
            "label": label,
            "network": bool(folds) and folds[0].kind == "network",
            "parameters": [method.parameters for method in folds],
            "lost": measured.lost.get(label),
            **{"means": {}, "intervals": {}, "by_group": {}, "pictures": []},
        }
        rows.append(row)
        if label not in kinds:
            continue
        own = cast("pd.DataFrame", by_group.loc[label]).reindex(range(count))
        for name, best_label in best.items():
            if label != best_label:
                own[MARGINS[name]] = own[name] - by_group.loc[best_label][name]
        own = own.drop(columns=SECONDS).dropna(axis="columns", how="all")
        images = table[table["method"] == label]
        for figure, column in own.items():
            row_estimate = estimate(column.to_numpy(float), names, resamples=resamples, seed=seed)
            row["means"][str(figure)] = plain(row_estimate.mean)
            if static:
                row["by_group"][str(figure)] = [plain(value) for value in column]
                if row_estimate.count > 1:
                    row["intervals"][str(figure)] = [row_estimate.low, row_estimate.high]
        row["means"][SECONDS] = float(images[SECONDS].median())
        row["pictures"] = [
            {name: plain(value) for name, value in row_estimate.items()}
            for _, row_estimate in sorted(measured.figures[label].items())
        ]
    return rows, best


def _about(groups: Sequence[Group], parts: Sequence[Part]) -> list[str]:
    frames = sum(len(group.shots) for group in groups)
    text = [f"{len(groups)} static groups of {frames} frames in all"]
    if len(groups) == 1:
        second = len(parts[0].judged)
        text = [
            f"one static group: filters are tuned on frames of its first half ({frames - second}) "
            f"and all rows judged on its second half ({second}), so there are no intervals"
        ]
    still = min(group.still for group in groups)
    if still < 1:
        text.append(f"moving objects are left out, at most {1 - still:.1%} of a sector")
    largest = max(group.largest_px for group in groups)
    text.append(f"frames lie at most {largest:.1f} pixels from that in the middle, which is undone")
    return text


_CALM = 15  # of the median that decides what is dark, pixels
_DARKEST = 0.1  # share of the sector
_BRIGHTER = 0.5  # share of the sector


def score(image: Grey, reference: Grey, mask: Mask) -> tuple[float, float]:
    """PSNR in dB and SSIM of an image against its reference, after one gain and offset."""
    fitted = fit_levels([(image[mask], reference[mask])])(image)
    return (
        finite_psnr(psnr(reference, fitted, data_range=1.0, mask=mask)),
        ssim(reference, fitted, data_range=1.0, mask=mask),
    )


@dataclass(frozen=True)
class Scene:
    """What all methods share on an image; all chosen on the image as it is.

    sector, dark, bright: (H, W) bool.  zones: (N, 2) corners of even blocks.
    """

    noisy: Grey
    sector: Mask
    dark: Mask
    bright: Mask
    zones: npt.NDArray[np.int64]


def scene_of(noisy: Grey, sector: Mask, name: str) -> Scene:
    """What is measured on an image, (H, W) in 0..1; sector: (H, W) bool.

    Raises FactoryError, which names it, when it is too small or black.
    """
    if min(noisy.shape) < SIDE or not sector.any() or not noisy[sector].any():
        raise FactoryError(f"{name}: black, or smaller than {SIDE} pixels; take it out")
    calm = cv2.medianBlur(np.rint(np.clip(noisy, 0, 1) * 255).astype(np.uint8), _CALM)
    # Near the edge of the sector the median sees black that is no shadow.
    inner = cv2.erode(sector.astype(np.uint8), np.ones((_CALM, _CALM), np.uint8)).astype(bool)
    inner = inner if inner.any() else sector
    low, high = np.quantile(calm[inner], (_DARKEST, _BRIGHTER))
    dark = inner & (calm <= low)
    bright = inner & (calm > max(low, high))
    return Scene(
        noisy, sector, dark, bright, homogeneous_zones(noisy, data_range=1.0, sector=sector)
    )


def figures_of(image: Grey, shared: Scene) -> Figures:
    """The figures without a truth of (H, W) in 0..1; NaN where one does not exist."""
    return {
        "enl": enl(image, shared.zones),
        "cnr": contrast_to_noise(image, shared.bright, shared.dark),
        "edges_kept": edge_preservation(shared.noisy, image, data_range=1.0, mask=shared.sector),
        **ratio_figures(shared.noisy, image, shared.sector),
    }


@dataclass(frozen=True, eq=False)
class RealImage(Subject):
    """A judged image."""

    judged: Judged

    def noisy_image(self) -> Grey:
        """See `Subject`."""
        return self.judged.noisy

    def geometry(self) -> FanGeometry | None:
        """See `Subject`."""
        return self.judged.geometry

    def measure(self, image: Grey) -> Figures:
        """Nearness to the reference after one gain and offset, and the figures without a truth."""
        judged = self.judged
        figures = figures_of(image, self._scene)
        if judged.reference is None:
            return figures
        psnr_db, similarity = score(image, judged.reference, judged.mask)
        near = {"psnr_db": psnr_db, "ssim": similarity, "gain_db": psnr_db - self._before_db}
        return near | figures

    @cached_property
    def _scene(self) -> Scene:
        return scene_of(self.judged.noisy, self.judged.mask, str(self.judged.shot.path))

    @cached_property
    def _before_db(self) -> float:
        """PSNR of the image as it is."""
        assert self.judged.reference is not None
        return score(self.judged.noisy, self.judged.reference, self.judged.mask)[0]
