"""Means over groups with their uncertainty, and how far each row is ahead of the best filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ..metrics.statistics import estimate
from ..runner import SECONDS, Measured

if TYPE_CHECKING:
    from .judging import RealRow

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
    cpu_s, among the means, is the median over the pictures, because the first loads and compiles.
    unchanged, pictures: how many pictures came back as they were, of how many.
    """

    means: dict[str, float]
    intervals: dict[str, tuple[float, float]]
    groups: dict[str, npt.NDArray[np.float64]]
    unchanged: int
    pictures: int


def summaries(
    rows: Sequence[RealRow], measured: Measured, groups: Groups, *, resamples: int, seed: int
) -> tuple[dict[str, Summary], dict[str, str]]:
    """Label -> summary of each row that is not lost; figure -> label of the best filter in it."""
    table = measured.table()
    table["group"] = groups.member[table["picture"].to_numpy(int)]
    table = table.replace([np.inf, -np.inf], np.nan)
    every = range(len(groups.names))
    by_group = {
        label: part.drop(columns=["method", "picture"]).groupby("group").mean().reindex(every)
        for label, part in table.groupby("method", sort=False)
    }
    alive = [row for row in rows if row.label in by_group]
    filters = [r.label for r in alive if not (r.is_network or r.is_noisy or r.of_several)]
    best = {
        name: max(filters, key=lambda label: by_group[label][name].mean())
        for name in MARGINS
        if filters and name in table
    }
    found = {}
    for row in alive:
        own, pictures = by_group[row.label], table[table["method"] == row.label]
        if not row.of_several:
            for name, label in best.items():
                if row.label != label:
                    own[MARGINS[name]] = own[name] - by_group[label][name]
        names = [str(name) for name in own if name != SECONDS and own[name].notna().any()]
        values = {name: own[name].to_numpy(float) for name in names}
        known = {
            name: estimate(one, groups.names, resamples=resamples, seed=seed)
            for name, one in values.items()
        }
        means = {name: one.mean for name, one in known.items()}
        if pictures[SECONDS].notna().any():
            means[SECONDS] = float(pictures[SECONDS].median())
        found[row.label] = Summary(
            means,
            {n: (e.low, e.high) for n, e in known.items() if groups.static and e.count > 1},
            values,
            int((pictures["unchanged"] > 0).sum()),
            len(pictures),
        )
    return found, best
