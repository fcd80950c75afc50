"""From counts of pictures to figures with intervals: whole components are drawn, and seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...factory.seeds import stream
from .counts import Counts
from .pictures import WALL

Values = npt.NDArray[np.float64]

MIOU, OBJECTS, AP_OBJECTS, AP_CLASSES = "miou", "object_iou", "ap50_objects", "ap50_classes"


@dataclass(frozen=True, eq=False)
class Draws:
    """What the pictures are drawn by; the first draw is all of them once.

    component: (N,) of each picture.  weights: (draws, components) how often each is drawn.
    seeds: (draws, seeds) how often each training seed is.
    """

    component: npt.NDArray[np.int64]
    weights: Values
    seeds: Values

    @classmethod
    def of(cls, component: npt.NDArray[np.int64], seeds: int, resamples: int, seed: int) -> Draws:
        """So many bootstrap draws of whole components and of seeds."""
        random = stream(seed, "downstream", "bootstrap")
        parts = []
        for count in (int(component.max()) + 1, seeds):
            drawn = random.multinomial(count, np.full(count, 1 / count), size=resamples)
            parts.append(np.vstack([np.ones((1, count)), drawn]))
        return cls(component, *parts)


@dataclass(frozen=True)
class Interval:
    """A figure with its 95 % interval, and the figure of each seed; NaN where there is none."""

    value: float
    low: float
    high: float
    seeds: tuple[float, ...] = ()


def drawn_figures(
    runs: Sequence[Sequence[Counts]], counted: Sequence[int], draws: Draws
) -> dict[str, tuple[Values, Values]]:
    """Name of a figure -> (draws,) its values, and (seeds,) those of all pictures.

    runs: a seed each, with the counts of every picture.  counted: the classes that means are over.
    Names are MIOU and so on, and `iou_<class>`.
    """
    single: dict[str, list[Values]] = {}
    for run in runs:
        for name, values in _of_seed(run, counted, draws).items():
            single.setdefault(name, []).append(values)
    found = {}
    share = draws.seeds / draws.seeds.sum(axis=1, keepdims=True)
    for name, both in single.items():
        table = np.stack(both, axis=1)
        found[name] = ((table * share).sum(axis=1), table[0])
    return found


def interval(values: Values, seeds: Values) -> Interval:
    """Of draws, the first of which is the figure itself."""
    known = values[1:][np.isfinite(values[1:])]
    if not np.isfinite(values[0]) or not known.size:
        return Interval(float("nan"), float("nan"), float("nan"))
    low, high = np.quantile(known, [0.025, 0.975])
    return Interval(float(values[0]), float(low), float(high), tuple(map(float, seeds)))


def average_precision(score: Values, hit: Values, there: Values, weights: Values) -> Values:
    """(draws,) area below precision over recall, precision made falling (as COCO and VOC 2010).

    score, hit: (boxes,) of each box that was found.  there: (draws,) how many are there.
    weights: (draws, boxes) how often each box is drawn.  NaN where nothing is there.
    """
    order = np.argsort(-score, kind="stable")
    drawn = weights[:, order]
    right = np.cumsum(drawn * hit[order], axis=1)
    every = np.cumsum(drawn, axis=1)
    precision = right / np.maximum(every, 1e-12)
    precision = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
    gained = np.diff(right, axis=1, prepend=0.0)
    area = (gained * precision).sum(axis=1)
    return np.where(there > 0, area / np.where(there > 0, there, 1), np.nan)


def _of_seed(run: Sequence[Counts], counted: Sequence[int], draws: Draws) -> Mapping[str, Values]:
    hit, truth, found = (
        _drawn([getattr(one, name) for one in run], draws) for name in ("hit", "truth", "found")
    )
    # A class that a draw does not have does not count in it, whatever was found.
    ious = np.where(truth > 0, hit / np.maximum(truth + found - hit, 1), np.nan)
    both, real, said = _drawn([one.objects for one in run], draws).T
    there = _drawn([one.there for one in run], draws)
    precisions = [
        _precision(run, one, there[:, one], draws) for one in counted if one not in (0, WALL)
    ]
    figures = {
        MIOU: _mean([ious[:, one] for one in counted]),
        OBJECTS: np.where(real > 0, both / np.maximum(real + said - both, 1), np.nan),
        AP_OBJECTS: _precision(run, 0, there[:, 0], draws),
        AP_CLASSES: _mean(precisions or [np.full(len(draws.weights), np.nan)]),
    }
    return figures | {f"iou_{one}": ious[:, one] for one in range(ious.shape[1])}


def _drawn(values: Sequence[Sequence[int]], draws: Draws) -> Values:
    """(draws, K) sums of (pictures, K)."""
    table = np.asarray(values, np.float64)
    sums = np.zeros((draws.weights.shape[1], table.shape[1]))
    np.add.at(sums, draws.component, table)
    return draws.weights @ sums


def _precision(run: Sequence[Counts], one: int, there: Values, draws: Draws) -> Values:
    boxes = [
        (score, hit, int(draws.component[number]))
        for number, counts in enumerate(run)
        for score, hit in counts.boxes.get(one, ())
    ]
    if not boxes:
        return np.where(there > 0, 0.0, np.nan)
    score, hit, component = (np.asarray(part) for part in zip(*boxes, strict=True))
    return average_precision(score, hit.astype(np.float64), there, draws.weights[:, component])


def _mean(columns: Sequence[Values]) -> Values:
    """Mean over the classes that a draw has."""
    table = np.stack(columns)
    known = np.isfinite(table)
    sums = np.where(known, table, 0).sum(axis=0)
    return np.where(known.any(axis=0), sums / np.maximum(known.sum(axis=0), 1), np.nan)
