"""Real images judged: static groups are found, filters tuned, images measured, rows averaged."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple, TypedDict, cast

import cv2
import numpy as np

from ...factory.common.array_types import Bools, Int64s
from ...factory.common.errors import FactoryError
from ...factory.common.progress import progress_bar
from ...factory.common.workers.tasks import TaskLost, TaskPool
from ..filters import Baseline, Parameters
from ..judging import tuning
from ..judging.learned import learned_notes
from ..judging.methods import NOISY, Method, baselines_of, networks_at
from ..judging.recorded import RecordedImage, Stretch
from ..judging.runner import SECONDS, Measured, Subject, run
from ..judging.settings import RealSettings
from ..metrics.fidelity import edge_preservation, finite_psnr, psnr, ssim
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
from ..report.tables import plain
from .groups import (
    LEAST,
    Group,
    GroupPart,
    ReferencedFrame,
    Searched,
    alone,
    judged,
    parts_of,
    search,
)
from .in_time import judged_in_time

if TYPE_CHECKING:
    import pandas as pd

    from ...factory.dataset.fan_geometry import FanGeometry

TUNED = "tuned on others"
"""Form of the filters' methods."""
MARGINS = {"psnr_db": "margin_db", "ssim": "margin_ssim"}
"""Figure -> name of a method's margin in it over the best filter."""

_BATCH_IMAGES = 16  # images that are in memory at a time
_SEARCH_S = 3600.0  # longest search for groups in a stretch

_MEDIAN_PX = 15  # window of the median filter that separates dark from bright ground
_DARK_SHARE = 0.1  # darkest part of the sector
_BRIGHT_SHARE = 0.5  # brightest part of the sector


class ReportRow(TypedDict):
    """A row of the report as plain data.

    label: of the method.  network: whether the method is a network.
    parameters: of the method in each fold; one entry if untuned, none if tuning failed.
    lost: why the method has no figures; None if it has some.
    means: figure -> mean over the groups; seconds are the median over the images, because the
    first image loads and compiles.
    intervals: figure -> low and high end of the 95 % interval of its mean; empty for fewer than
    two static groups.
    by_group: figure -> mean of each static group, None where the group has no value.
    pictures: figures of each judged image, in the order of the images.
    """

    label: str
    network: bool
    parameters: list[Parameters]
    lost: str | None
    means: dict[str, float | None]
    intervals: dict[str, list[float]]
    by_group: dict[str, list[float | None]]
    pictures: list[dict[str, float | None]]


@dataclass(frozen=True, eq=False)
class RealOutcome:
    """The figures of all rows on all images.

    files: names of the judged images.  examples: number -> image, of those that the report shows;
    what the methods made of them is in `measured`.  best: figure -> label of the best filter in it.
    """

    groups: list[Group]
    parts: list[GroupPart]
    files: list[str]
    rows: list[ReportRow]
    measured: Measured
    examples: dict[int, ReferencedFrame]
    best: dict[str, str]
    in_time: pd.DataFrame
    notes: list[str]


class JudgingPlan(NamedTuple):
    """Which images are judged, and by which filters.

    shots: the judged images, in order.
    filters: the methods of each filter, one for each fold; a single one if untuned.
    group_of_image: (N,) number of the group of each image.
    lost: label -> why a filter could not be tuned.
    """

    shots: list[RecordedImage]
    filters: list[tuple[Method, ...]]
    group_of_image: Int64s
    lost: dict[str, str]


def judge(settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool) -> RealOutcome:
    """Find static groups, tune the filters, and measure every method.

    Raises FactoryError when something cannot be read, or there is nothing to judge.
    """
    baselines = baselines_of(settings.baselines)
    networks = networks_at(settings.models)
    warnings = learned_notes(stretches, networks)
    groups, shots, notes = _search_groups(settings, stretches, pool)
    parts = parts_of(groups)
    if groups:
        notes += _group_notes(groups, parts)
        plan = _plan_groups(settings, groups, parts, baselines, pool)
    else:
        plan = _plan_single_images(settings, shots, baselines)

    methods = [(NOISY,), *plan.filters, *((network,) for network in networks)]
    methods_by_label = {folds[0].label: folds for folds in methods}
    example_count = min(settings.examples, len(plan.shots))
    example_numbers = np.linspace(0, len(plan.shots) - 1, example_count).round().astype(int)
    measured, examples = _measure_methods(
        settings, groups, parts, plan.shots, methods_by_label, set(example_numbers.tolist()), pool
    )

    # Filters that could not be tuned were not measured, but have a row that says why.
    measured.lost |= plan.lost
    methods_by_label |= dict.fromkeys(plan.lost, ())
    rows, best = rows_of(
        methods_by_label,
        measured,
        plan.group_of_image,
        has_static_groups=bool(groups),
        resamples=settings.bootstrap,
        seed=settings.seed,
    )
    in_time, time_notes = judged_in_time(settings, groups, networks, pool)
    return RealOutcome(
        groups=groups,
        parts=parts,
        files=[shot.name for shot in plan.shots],
        rows=rows,
        measured=measured,
        examples=examples,
        best=best,
        in_time=in_time,
        notes=[*warnings, *notes, *time_notes],
    )


def _search_groups(
    settings: RealSettings, stretches: Sequence[Stretch], pool: TaskPool
) -> Searched:
    """Static groups, readable shots and notes of all stretches; no groups with `groups=false`."""
    if not settings.groups:
        return Searched([], [shot for stretch in stretches for shot in stretch.shots], [])
    waiting = deque((number, stretch, settings.limit) for number, stretch in enumerate(stretches))
    searched: dict[int, Searched] = {}
    with progress_bar(total=len(waiting), unit="folder", desc="static groups") as bar:
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


def _plan_groups(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[GroupPart],
    baselines: Sequence[Baseline],
    pool: TaskPool,
) -> JudgingPlan:
    """Judge frames of static groups by filters that were tuned on other frames."""
    parameters_of_filter, lost = _tune_filters(settings, groups, parts, baselines, pool)
    filters = [
        tuple(Method(name, TUNED, parameters) for _, parameters in sorted(of_fold.items()))
        for name, of_fold in parameters_of_filter.items()
    ]
    shots: list[RecordedImage] = []
    for group, part in zip(groups, parts, strict=True):
        shots += [group.shots[place] for place in part.judged]
    group_of_image = np.repeat(np.arange(len(parts)), [len(part.judged) for part in parts])
    return JudgingPlan(shots, filters, group_of_image, lost)


def _plan_single_images(
    settings: RealSettings, shots: Sequence[RecordedImage], baselines: Sequence[Baseline]
) -> JudgingPlan:
    """Judge images without references by filters at their default parameters."""
    judged_shots = evenly(shots, settings.limit)
    filters: list[tuple[Method, ...]] = [
        (Method(baseline.name, "", dict(baseline.default)),) for baseline in baselines
    ]
    group_of_image = np.arange(len(judged_shots))  # every image is a group
    return JudgingPlan(judged_shots, filters, group_of_image, {})


def _tune_filters(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[GroupPart],
    baselines: Sequence[Baseline],
    pool: TaskPool,
) -> tuple[dict[str, dict[int, Parameters]], dict[str, str]]:
    """Filter -> fold -> parameters; and label -> why a filter could not be tuned."""
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
    longest_s = settings.image_timeout_s * max(map(len, samples_of_fold.values()))
    parameters: dict[str, dict[int, Parameters]] = {name: {} for name in filters}
    lost: dict[str, str] = {}
    for task, tuned in tuning.run_tasks(tuning.on_frames, tasks, pool, lambda _: longest_s):
        if isinstance(tuned, str):
            lost.setdefault(f"{task.baseline} {TUNED}", f"tuning: {tuned}")
            parameters.pop(task.baseline, None)
        elif task.baseline in parameters:
            parameters[task.baseline][task.fold] = tuned
    return parameters, lost


def _measure_methods(
    settings: RealSettings,
    groups: Sequence[Group],
    parts: Sequence[GroupPart],
    shots: Sequence[RecordedImage],
    methods_by_label: Mapping[str, Sequence[Method]],
    example_numbers: set[int],
    pool: TaskPool,
) -> tuple[Measured, dict[int, ReferencedFrame]]:
    """Every method on every image, fold after fold; and number -> image of the examples."""
    all_measured = Measured({label: {} for label in methods_by_label})
    examples: dict[int, ReferencedFrame] = {}
    image_count = len(shots) * len(methods_by_label)
    with progress_bar(total=image_count, unit="image", desc="judging") as bar:
        for fold in sorted({part.fold for part in parts}) or [0]:
            # An untuned method is the same in every fold.
            methods = [folds[fold % len(folds)] for folds in methods_by_label.values()]
            images = _images_of_fold(fold, groups, parts, shots)
            measured = run(
                [method for method in methods if method.label not in all_measured.lost],
                _batches(images, example_numbers, examples),
                pool,
                device=settings.device,
                timeout_s=settings.image_timeout_s,
                keep=example_numbers.__contains__,
                tick=bar.update,
            )
            for label, figures in measured.figures.items():
                all_measured.figures[label] |= figures
            all_measured.lost |= measured.lost
            all_measured.images |= measured.images
    return all_measured, examples


def _batches(
    images: Iterator[tuple[int, ReferencedFrame]],
    example_numbers: set[int],
    examples: dict[int, ReferencedFrame],
) -> Iterator[dict[int, Subject]]:
    """The images in batches as `run` takes them; those of the examples are kept in `examples`."""
    while batch := dict(islice(images, _BATCH_IMAGES)):
        examples.update({number: batch[number] for number in example_numbers & batch.keys()})
        yield {number: RealSubject(image) for number, image in batch.items()}


def _images_of_fold(
    fold: int, groups: Sequence[Group], parts: Sequence[GroupPart], shots: Sequence[RecordedImage]
) -> Iterator[tuple[int, ReferencedFrame]]:
    """Number and image of all that is judged in a fold; without groups these are all shots."""
    if not groups:
        yield from enumerate(map(alone, shots))
        return
    first_number = 0
    for group_number, (group, part) in enumerate(zip(groups, parts, strict=True)):
        if part.fold == fold:
            yield from enumerate(judged(group_number, group, part.judged), first_number)
        first_number += len(part.judged)


def rows_of(
    methods: Mapping[str, Sequence[Method]],
    measured: Measured,
    group_of_image: Int64s,
    *,
    has_static_groups: bool,
    resamples: int,
    seed: int,
) -> tuple[list[ReportRow], dict[str, str]]:
    """The rows of the report; and figure -> label of the best filter in it.

    methods: label -> its method for each fold; one entry if untuned, none if lost.
    group_of_image: (N,) number of the group of each judged image.
    has_static_groups: whether groups are static scenes; if not, every image is a group.
    """
    table = _figures_table(measured, group_of_image)
    group_means = table.drop(columns="picture").groupby(["method", "group"], sort=False).mean()
    best = _best_filters(methods, group_means)
    groups = range(int(group_of_image.max(initial=-1)) + 1)
    rows: list[ReportRow] = []
    for label, folds in methods.items():
        row = _report_row(label, folds, measured)
        rows.append(row)
        if label not in group_means.index:  # the method is lost
            continue
        group_values = _group_values(label, group_means, best).reindex(groups)
        image_seconds = table.loc[table["method"] == label, SECONDS]
        _add_means(row, group_values, has_static_groups, resamples=resamples, seed=seed)
        row["means"][SECONDS] = float(image_seconds.median())
    return rows, best


def _figures_table(measured: Measured, group_of_image: Int64s) -> pd.DataFrame:
    """A row for each method and image: method, picture (its number), figures, group."""
    table = measured.table().replace([np.inf, -np.inf], np.nan)
    table["group"] = group_of_image[table["picture"].to_numpy(int)]
    return table


def _best_filters(
    methods: Mapping[str, Sequence[Method]], group_means: pd.DataFrame
) -> dict[str, str]:
    """Figure of `MARGINS` -> label of the filter with the greatest mean over the groups."""
    method_means = group_means.groupby("method", sort=False).mean()
    filters = [
        label
        for label, folds in methods.items()
        if label in method_means.index and folds[0].kind == "baseline"
    ]
    if not filters:
        return {}
    figures = [figure for figure in MARGINS if figure in method_means]
    return {figure: str(method_means.loc[filters, figure].idxmax()) for figure in figures}


def _report_row(label: str, folds: Sequence[Method], measured: Measured) -> ReportRow:
    """The row of a method, still without means over groups."""
    row = ReportRow(
        label=label,
        network=bool(folds) and folds[0].kind == "network",
        parameters=[method.parameters for method in folds],
        lost=measured.lost.get(label),
        means={},
        intervals={},
        by_group={},
        pictures=[],
    )
    if row["lost"] is None:
        row["pictures"] = [
            {figure: plain(value) for figure, value in image_figures.items()}
            for _, image_figures in sorted(measured.figures[label].items())
        ]
    return row


def _group_values(label: str, group_means: pd.DataFrame, best: Mapping[str, str]) -> pd.DataFrame:
    """A row for each group: the figures of a method, and its margins over the best filters."""
    group_values = cast("pd.DataFrame", group_means.loc[label]).copy()
    for figure, best_label in best.items():
        if label != best_label:
            group_values[MARGINS[figure]] = (
                group_values[figure] - group_means.loc[best_label][figure]
            )
    return group_values.drop(columns=SECONDS).dropna(axis="columns", how="all")


def _add_means(
    row: ReportRow,
    group_values: pd.DataFrame,
    has_static_groups: bool,
    *,
    resamples: int,
    seed: int,
) -> None:
    """Fill in means over groups; of static groups the values of each, and intervals."""
    group_names = [str(number) for number in group_values.index]
    for figure, column in group_values.items():
        name = str(figure)
        over_groups = estimate(column.to_numpy(float), group_names, resamples=resamples, seed=seed)
        row["means"][name] = plain(over_groups.mean)
        if not has_static_groups:
            continue
        row["by_group"][name] = [plain(value) for value in column]
        if over_groups.count > 1:
            row["intervals"][name] = [over_groups.low, over_groups.high]


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


def score(image: Grey, reference: Grey, mask: Bools) -> tuple[float, float]:
    """PSNR in dB and SSIM of an image against its reference, after one gain and offset."""
    levels = fit_levels([(image[mask], reference[mask])])
    fitted = levels(image)
    return (
        finite_psnr(psnr(reference, fitted, data_range=1.0, mask=mask)),
        ssim(reference, fitted, data_range=1.0, mask=mask),
    )


@dataclass(frozen=True)
class MeasuredImage:
    """A noisy image and its regions, in which the output of every method is measured.

    sector: (H, W) bool, the insonified part.  dark, bright: (H, W) bool, dark and bright ground.
    zones: (N, 2) corners of homogeneous blocks.
    """

    noisy: Grey
    sector: Bools
    dark: Bools
    bright: Bools
    zones: Int64s


def scene_of(noisy: Grey, sector: Bools, name: str) -> MeasuredImage:
    """The regions of an image, (H, W) in 0..1; sector: (H, W) bool.

    Raises FactoryError, which names the image, when it is too small or black.
    """
    if min(noisy.shape) < SIDE or not sector.any() or not noisy[sector].any():
        raise FactoryError(f"{name}: black, or smaller than {SIDE} pixels; take it out")
    levels = np.rint(np.clip(noisy, 0, 1) * 255).astype(np.uint8)
    smooth = cv2.medianBlur(levels, _MEDIAN_PX)
    # Near the edge of the sector the median sees black that is no shadow.
    window = np.ones((_MEDIAN_PX, _MEDIAN_PX), np.uint8)
    inner = cv2.erode(sector.astype(np.uint8), window).astype(bool)
    if not inner.any():
        inner = sector
    low, high = np.quantile(smooth[inner], (_DARK_SHARE, 1 - _BRIGHT_SHARE))
    return MeasuredImage(
        noisy,
        sector,
        dark=inner & (smooth <= low),
        bright=inner & (smooth > max(low, high)),
        zones=homogeneous_zones(noisy, data_range=1.0, sector=sector),
    )


def figures_of(image: Grey, scene: MeasuredImage) -> Figures:
    """The figures without a truth of an image, (H, W) in 0..1; NaN where one is undefined."""
    return {
        "enl": enl(image, scene.zones),
        "cnr": contrast_to_noise(image, scene.bright, scene.dark),
        "edges_kept": edge_preservation(scene.noisy, image, data_range=1.0, mask=scene.sector),
        **ratio_figures(scene.noisy, image, scene.sector),
    }


@dataclass(frozen=True, eq=False)
class RealSubject(Subject):
    """A judged image as methods and workers get it."""

    judged: ReferencedFrame

    def noisy_image(self) -> Grey:
        """See `Subject`."""
        return self.judged.noisy

    def geometry(self) -> FanGeometry | None:
        """See `Subject`."""
        return self.judged.geometry

    def measure(self, image: Grey) -> Figures:
        """Likeness to the reference, if there is one, and the figures without a truth."""
        figures = figures_of(image, self._scene)
        if self.judged.reference is None:
            return figures
        psnr_db, similarity = score(image, self.judged.reference, self.judged.mask)
        gain_db = psnr_db - self._noisy_psnr_db
        return {"psnr_db": psnr_db, "ssim": similarity, "gain_db": gain_db, **figures}

    @cached_property
    def _scene(self) -> MeasuredImage:
        return scene_of(self.judged.noisy, self.judged.mask, str(self.judged.shot.path))

    @cached_property
    def _noisy_psnr_db(self) -> float:
        """PSNR of the image before denoising."""
        assert self.judged.reference is not None
        return score(self.judged.noisy, self.judged.reference, self.judged.mask)[0]
