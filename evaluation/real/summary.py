"""Means over groups with their uncertainty, and how far each row is ahead of the best filter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ..metrics.statistics import Estimate, estimate
from .measure import Figures, RealRow

MARGINS = {"psnr_db": "margin_db", "ssim": "margin_ssim"}
"""Figure -> name of what a row has more of it than the best filter."""


@dataclass(frozen=True)
class Groups:
    """names: of the groups, each once.  member: (N,) group of each judged picture.

    static: false where no scene stands still; every picture then is a group.
    """

    static: bool
    names: tuple[str, ...]
    member: npt.NDArray[np.int64]


@dataclass(frozen=True)
class Summary:
    """A row over all groups.

    means, intervals: figure -> mean over the groups and its 95 % interval, which there is of two
    groups at least.
    groups: figure -> (groups,) mean of each group, NaN where there is none.
    cpu_s, among the means, is the median over the pictures.
    unchanged, pictures: how many pictures came back as they were, of how many.
    """

    means: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    groups: dict[str, npt.NDArray[np.float64]]
    unchanged: int
    pictures: int


def summaries(
    rows: Sequence[RealRow], groups: Groups, *, resamples: int, seed: int
) -> tuple[dict[str, Summary], dict[str, str]]:
    """Label -> summary of each row that is not lost; figure -> label of the best filter in it."""
    alive = [row for row in rows if row.lost is None]
    means = {row.label: _group_means(row, groups) for row in alive}
    filters = [row.label for row in alive if row.methods and not row.is_network]
    best = {}
    for name in MARGINS:
        scored = {
            label: float(np.nanmean(means[label][name]))
            for label in filters
            if name in means[label] and label != "noisy"
        }
        if scored:
            best[name] = max(scored, key=lambda label: scored[label])
    found = {}
    for row in alive:
        own = means[row.label]
        if row.methods and not row.sees_several:  # several frames have another reference
            for name, label in best.items():
                if row.label != label:
                    own[MARGINS[name]] = own[name] - means[label][name]
        known: dict[str, Estimate] = {
            name: estimate(values, groups.names, resamples=resamples, seed=seed)
            for name, values in own.items()
            if name != "cpu_s"
        }
        given = [one for one in row.figures if one is not None]
        found[row.label] = Summary(
            {name: one.mean for name, one in known.items() if one.count} | _seconds(given),
            {n: (e.low, e.high) for n, e in known.items() if groups.static and e.count > 1},
            own,
            sum(one["unchanged"] > 0 for one in given),
            len(given),
        )
    return found, best


def _seconds(figures: Sequence[Figures]) -> dict[str, float]:
    """The median, because the first picture loads and compiles."""
    known = [one["cpu_s"] for one in figures if "cpu_s" in one]
    return {"cpu_s": float(np.median(known))} if known else {}


def _group_means(row: RealRow, groups: Groups) -> dict[str, npt.NDArray[np.float64]]:
    names = dict.fromkeys(name for one in row.figures if one is not None for name in one)
    found = {}
    for name in names:
        values = np.array(
            [math.nan if one is None else one.get(name, math.nan) for one in row.figures]
        )
        finite = np.isfinite(values)
        member = groups.member[finite]
        counts = np.bincount(member, minlength=len(groups.names))
        sums = np.bincount(member, weights=values[finite], minlength=len(groups.names))
        found[name] = np.where(counts > 0, sums / np.maximum(counts, 1), np.nan)
    return found


def plain(value: Any) -> float | None:
    """A number as JSON takes it, None for none."""
    return float(value) if value is not None and math.isfinite(value) else None
