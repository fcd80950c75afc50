"""The comparison as a Markdown table."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ...factory.dataset.describe import markdown
from .compare import Comparison, overall

_OVERALL = {
    "geometric_mean_ratio": "mean ratio",
    "median_ratio": "median ratio",
    "within_2": "within 2 times",
}


def table(comparisons: Sequence[Comparison]) -> str:
    """Markdown: the baseline, every simulation's distance, and how many times the baseline."""
    names = list(comparisons[0].distance)
    head = ["real against", "unit", "real", *(cell for name in names for cell in (name, "ratio"))]
    rows = []
    for item in comparisons:
        cells = [item.statistic.label, item.statistic.unit, number(item.baseline.mean)]
        for name in names:
            cells += [number(item.distance[name].mean), times(item.ratio(name))]
        rows.append(cells)
    for label, values in sums(comparisons):
        rows.append([f"**{label}**", "", "", *(cell for value in values for cell in ("", value))])
    return markdown.table(head, rows, "llr")


def sums(comparisons: Sequence[Comparison]) -> list[tuple[str, list[str]]]:
    """(label, its value for each simulation) of the figures that sum up the whole table."""
    found = [overall(comparisons, name) for name in comparisons[0].distance]
    return [(label, [_sum(key, one[key]) for one in found]) for key, label in _OVERALL.items()]


def _sum(key: str, value: float) -> str:
    return f"{value:.0%}" if key == "within_2" and math.isfinite(value) else times(value)


def number(value: float) -> str:
    """Three digits, or a dash where there is no figure."""
    return f"{value:.3g}" if math.isfinite(value) else "-"


def times(value: float) -> str:
    """A ratio as people read it."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"
