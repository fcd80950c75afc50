"""What the results say together: a table a set, with intervals, and tests against a filter."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...factory.dataset.describe import markdown
from ..metrics.statistics import Estimate, Paired, estimate, holm, paired
from ..report.names import written, written_p
from .folder import Benchmark, PictureSet
from .measure import METRICS, RANKED
from .results import Result

_RESAMPLES, _SEED = 2000, 0
_WITH_INTERVAL = ("psnr", "psnr_levels")


@dataclass(frozen=True, eq=False)
class Row:
    """A method on a set.

    margin: how far it is ahead of the best filter in the ranked figure; None for that filter.
    p_holm: of the paired test, corrected over the rows.
    """

    result: Result
    means: dict[str, Estimate]
    cpu_s: float | None
    margin: Paired | None
    p_holm: float


@dataclass(frozen=True, eq=False)
class SetTable:
    """A set's rows, best first.  best_filter: its name, None where no filter has entered."""

    pictures: PictureSet
    ranked: str
    best_filter: str | None
    rows: list[Row]

    @property
    def metrics(self) -> list[str]:
        """The figures that there are."""
        return [n for n in METRICS if any(n in row.means for row in self.rows)]

    @property
    def about(self) -> str:
        """How many pictures of what."""
        groups = len(set(self.pictures.groups))
        best = f"the best filter is {self.best_filter}" if self.best_filter else "no filter entered"
        return (
            f"{self.pictures.entry.about}. {len(self.pictures.pictures)} pictures of {groups} "
            f"scenes; {best}."
        )


def tables(benchmark: Benchmark, results: Sequence[Result]) -> list[SetTable]:
    """A table of each set of the benchmark."""
    return [_table(one, results) for one in benchmark.sets.values()]


def _table(pictures: PictureSet, results: Sequence[Result]) -> SetTable:
    here = [one for one in results if pictures.name in one.sets]
    ranked = RANKED[pictures.entry.kind]

    def values(one: Result, name: str) -> np.ndarray:
        return one.sets[pictures.name].column(name)

    means = {one.name: _mean(values(one, ranked)) for one in here}
    here.sort(key=lambda one: (-means[one.name], one.name))
    best = next((one for one in here if one.is_filter), None)
    margins: list[Paired | None] = [
        None
        if best is None or one is best
        else paired(
            values(one, ranked),
            values(best, ranked),
            pictures.groups,
            better=1,
            resamples=_RESAMPLES,
            seed=_SEED,
        )
        for one in here
    ]
    adjusted = holm([math.nan if one is None else one.p for one in margins])
    rows = [
        Row(
            one,
            {
                name: estimate(values(one, name), pictures.groups, resamples=_RESAMPLES, seed=_SEED)
                for name in METRICS
                if name in one.sets[pictures.name].figures
            },
            one.sets[pictures.name].median_cpu_s,
            margin,
            p,
        )
        for one, margin, p in zip(here, margins, adjusted, strict=True)
    ]
    return SetTable(pictures, ranked, None if best is None else best.name, rows)


def head(table: SetTable) -> list[str]:
    """The columns of a set."""
    labels = [METRICS[name].label for name in table.metrics]
    return ["method", *labels[:1], "ahead of the best filter, dB", "p (Holm)", *labels[1:], "CPU s"]


def cells(table: SetTable, row: Row) -> list[str]:
    """A row as text."""
    figures = [_figure(row, name) for name in table.metrics]
    margin = "" if row.margin is None else _signed(row.margin.difference)
    return [
        row.result.name,
        *figures[:1],
        margin,
        "" if row.margin is None else written_p(row.p_holm),
        *figures[1:],
        written(row.cpu_s, 3),
    ]


def overview(found: Sequence[SetTable]) -> tuple[list[str], list[list[str]]]:
    """Head and rows of the table of all methods and sets, by the mean over sets."""
    by_method: dict[str, dict[str, float]] = {}
    for table in found:
        for row in table.rows:
            own = by_method.setdefault(row.result.name, {})
            own[table.pictures.name] = row.means[table.ranked].mean
    order = sorted(by_method, key=lambda name: (-_mean(list(by_method[name].values())), name))
    # A method without all sets cannot be compared by its mean.
    order.sort(key=lambda name: -len(by_method[name]))
    names = [table.pictures.name for table in found]
    rows = [
        [name, *(written(by_method[name].get(one), METRICS["psnr"].digits) for one in names)]
        for name in order
    ]
    return ["method", *names], rows


def as_markdown(benchmark: Benchmark, results: Sequence[Result]) -> str:
    """All tables."""
    found = tables(benchmark, results)
    parts = [
        f"# Benchmark of sonar denoisers, version {benchmark.manifest.version}",
        "PSNR in dB by set; of real sonars after one gain and offset a picture.",
        markdown.table(*overview(found)),
    ]
    for one in found:
        lines = [cells(one, row) for row in one.rows]
        parts += [f"## {one.pictures.name}", one.about, markdown.table(head(one), lines)]
    parts += ["## Hashes of the sets", markdown.table(["set", "sha256"], digests(found), "ll")]
    return "\n\n".join([*parts, ""])


def digests(found: Sequence[SetTable]) -> list[list[str]]:
    """Set and digest."""
    return [[one.pictures.name, one.pictures.entry.digest] for one in found]


def _figure(row: Row, name: str) -> str:
    found, digits = row.means.get(name), METRICS[name].digits
    if found is None:
        return "-"
    text = written(found.mean, digits)
    if name in _WITH_INTERVAL and found.count:
        text += f" ({written(found.low, digits)} .. {written(found.high, digits)})"
    return text


def _signed(found: Estimate) -> str:
    mean, low, high = (written(one, 2, True) for one in (found.mean, found.low, found.high))
    return f"{mean} ({low} .. {high})"


def _mean(values: Any) -> float:
    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    return float(known.mean()) if known.size else -math.inf
