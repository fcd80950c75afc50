"""Every baseline on every pair: default and tuned, with and without levels, against noisy."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from evaluation import metrics
from evaluation.baselines import REGISTRY, chosen
from evaluation.baselines.base import Gray, Parameters
from evaluation.levels import Levels
from evaluation.measure import METRICS, EvaluationSettings, in_order, score_pair
from evaluation.pictures import Item, Picture, input_of, items_of, picture
from evaluation.statistics import Estimate, estimate
from evaluation.texture import TEXTURE, texture_of
from evaluation.tuning import BaselineSettings, load_tuned, reason, tuned_file
from factory.errors import FactoryError

_CHUNK = 4


@dataclass(frozen=True)
class Method:
    """A row before it is measured.  form: '', 'tuned', '+ levels' or 'tuned + levels'."""

    baseline: str
    form: str
    parameters: Parameters
    levels: Levels | None

    @property
    def label(self) -> str:
        """The name of the row."""
        return f"{self.baseline} {self.form}".strip()


@dataclass(frozen=True)
class Row:
    """A measured row.  lost: why there is none; then there are no figures.

    values: metric -> (N,) figures in the order of the items, NaN where it does not exist.
    gains: metric -> paired difference to the noisy images, with its interval.
    """

    method: Method
    values: dict[str, np.ndarray[Any, np.dtype[np.float64]]]
    means: dict[str, Estimate]
    gains: dict[str, Estimate]
    milliseconds: float
    lost: str | None = None


@dataclass(frozen=True)
class _Task:
    methods: tuple[Method, ...]
    items: tuple[Item, ...]
    shadow_threshold: float
    texture: bool


_Measured = dict[str, float]
_Found = list[tuple[str | None, list[_Measured]]]
"""One entry a method: why it failed, or a dictionary of figures a pair."""


def methods_of(
    settings: EvaluationSettings, own: BaselineSettings
) -> tuple[list[Method], list[str]]:
    """The rows to measure, and the names of the baselines that are not tuned yet."""
    known = load_tuned(tuned_file(settings, own))
    methods, untuned = [], []
    for baseline in chosen(own.baselines):
        methods.append(Method(baseline.name, "", dict(baseline.default), None))
        entry = known.get(baseline.name)
        if entry is None:
            untuned.append(baseline.name)
            continue
        forms = [("+ levels", "default")]
        if baseline.grid:
            forms += [("tuned", "tuned"), ("tuned + levels", "tuned_levels")]
        for form, key in forms:
            point = entry[key]
            levels = Levels(**point["levels"]) if form.endswith("levels") else None
            methods.append(Method(baseline.name, form, point["parameters"], levels))
    return methods, untuned


def leaderboard(
    settings: EvaluationSettings, methods: Sequence[Method], *, texture: bool
) -> tuple[list[Item], list[Row]]:
    """Measure the methods on the split; the first row is the noisy images themselves.

    A method that fails on any pair loses its row and says why.  Raises FactoryError for a dataset
    that cannot be read.
    """
    items = items_of(Path(settings.dataset.dir), settings.split)[: settings.limit]
    noisy = Method("identity", "", {}, None)
    rest = tuple(method for method in methods if method != noisy)
    every = (noisy, *rest)
    tasks = [
        _Task(every, tuple(items[i : i + _CHUNK]), settings.shadow_threshold, texture)
        for i in range(0, len(items), _CHUNK)
    ]
    workers = os.cpu_count() or 1 if settings.workers == "auto" else settings.workers
    found: list[_Found] = []
    with tqdm(total=len(items), unit="pair", desc="baselines") as bar:
        for task, part in zip(
            tasks, in_order(_measure, tasks, max(1, min(workers, len(tasks)))), strict=True
        ):
            found.append(part)
            bar.update(len(task.items))
    groups = [item.group for item in items]
    rows: list[Row] = []
    for number, method in enumerate(every):
        parts = [part[number] for part in found]
        origin = rows[0].values if rows else None
        rows.append(_row(method, parts, groups, origin, settings))
    return items, rows


def _row(
    method: Method,
    parts: list[tuple[str | None, list[_Measured]]],
    groups: list[str],
    origin: dict[str, np.ndarray[Any, np.dtype[np.float64]]] | None,
    settings: EvaluationSettings,
) -> Row:
    failed = [error for error, _ in parts if error is not None]
    if failed:
        return Row(method, {}, {}, {}, float("nan"), failed[0])
    measured = [pair for _, pairs in parts for pair in pairs]
    names = [name for name in measured[0] if name != "milliseconds"]
    values = {name: np.array([pair[name] for pair in measured]) for name in names}
    for name in values:
        if name.startswith("psnr"):
            values[name] = np.minimum(values[name], metrics.PSNR_CAP_DB)

    def mean(figures: np.ndarray[Any, np.dtype[np.float64]]) -> Estimate:
        return estimate(figures, groups, resamples=settings.bootstrap, seed=settings.seed)

    return Row(
        method,
        values,
        {name: mean(figures) for name, figures in values.items()},
        {} if origin is None else {name: mean(_difference(values, origin, name)) for name in names},
        float(np.median([pair["milliseconds"] for pair in measured])),
    )


def _difference(
    values: dict[str, np.ndarray[Any, np.dtype[np.float64]]],
    origin: dict[str, np.ndarray[Any, np.dtype[np.float64]]],
    name: str,
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Pair by pair; where a figure is infinite or absent there is no difference."""
    both = np.isfinite(values[name]) & np.isfinite(origin[name])
    result = np.full(both.shape, np.nan)
    result[both] = values[name][both] - origin[name][both]
    return result


def _measure(task: _Task) -> _Found:
    found: _Found = []
    # Rows with the same filter and other levels share its output.
    outputs: dict[str, tuple[str | None, list[Gray], list[float]]] = {}
    for method in task.methods:
        key = f"{method.baseline} {sorted(method.parameters.items())}"
        if key not in outputs:
            outputs[key] = _filtered(method, task.items)
        error, images, times = outputs[key]
        if error is not None:
            found.append((error, []))
            continue
        pairs = []
        for item, image, milliseconds in zip(task.items, images, times, strict=True):
            corrected = image if method.levels is None else method.levels(image)
            figures = _figures(corrected, picture(item.place), task, item)
            pairs.append({**figures, "milliseconds": milliseconds})
        found.append((None, pairs))
    return found


def _filtered(
    method: Method, items: tuple[Item, ...]
) -> tuple[str | None, list[Gray], list[float]]:
    baseline = REGISTRY[method.baseline]
    if baseline.looks and any(len(item.looks) < 2 for item in items):
        return "needs several noise variants a frame", [], []
    images, times = [], []
    for item in items:
        image = input_of(item, baseline.looks)
        start = time.perf_counter()
        try:
            images.append(baseline(image, method.parameters))
        except Exception as error:  # a method that crashes loses its row, not the report
            return reason(error), [], []
        times.append(1000 * (time.perf_counter() - start))
    return None, images, times


def _figures(image: Gray, pair: Picture, task: _Task, item: Item) -> _Measured:
    try:
        quality = score_pair(
            image,
            pair.clean,
            pair.shadow,
            data_range=1.0,
            shadow_threshold=task.shadow_threshold,
            sector=pair.sector,
        )
        more = asdict(texture_of(image, pair)) if task.texture else {}
    except metrics.MetricError as error:
        raise FactoryError(f"{item.shard}: sample {item.place[1]}: {error}") from error
    return {**asdict(quality), **more}


def columns(rows: Sequence[Row]) -> tuple[str, ...]:
    """The metrics that the rows have, in the order of the tables."""
    return tuple(name for name in (*METRICS, *TEXTURE) if name in rows[0].values)
