"""The tables of a report as one picture."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.report import Section, Table, shown
from simnfnd.factory.dataset.describe.palette import BLUE

_ROW_INCHES, _LINES_INCHES, _WIDE = 0.32, 2.6, 9.0


def draw(sections: Mapping[str, Section], path: Path) -> bool:
    """Draw every table that asks for it, one below the other; False when none does."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels = [
        (f"{name}: {table.title or table.bars}" if table.title else f"{name}: {table.bars}", table)
        for name, section in sections.items()
        for table in section.tables
        if table.rows and (table.bars or table.lines)
    ]
    if not panels:
        return False
    heights = [
        _LINES_INCHES if table.lines else 0.5 + _ROW_INCHES * len(table.rows) for _, table in panels
    ]
    figure, axes = plt.subplots(
        len(panels),
        1,
        figsize=(_WIDE, sum(heights) + 0.8 * len(panels)),
        gridspec_kw={"height_ratios": heights},
        squeeze=False,
        layout="constrained",
    )
    for (title, table), axis in zip(panels, axes[:, 0], strict=True):
        axis.set_title(title, loc="left", fontsize=10, fontweight="bold")
        axis.spines[["top", "right"]].set_visible(False)
        (_lines if table.lines else _bars)(axis, table)
    figure.savefig(path, dpi=110)
    plt.close(figure)
    return True


def _bars(axis: Any, table: Table) -> None:
    labels = [str(cell) for cell in table.column(table.columns[0])]
    values = [
        float(cell) if isinstance(cell, int | float) else 0.0 for cell in table.column(table.bars)
    ]
    places = list(range(len(values)))
    axis.barh(places, values, color=BLUE, height=0.7)
    axis.set_yticks(places, labels, fontsize=8)
    axis.invert_yaxis()
    good = [value for value in values if value > 0]
    if good and max(good) > 30 * min(good):
        axis.set_xscale("log")
        axis.set_xlim(min(good) / 2, max(good) * 3)
    else:
        axis.set_xlim(0, 1.12 * max(good, default=1.0))
    for place, value in zip(places, values, strict=True):
        axis.annotate(
            shown(value),
            (value, place),
            (4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    axis.set_xlabel(table.bars, fontsize=8)
    axis.tick_params(labelsize=8)


def _lines(axis: Any, table: Table) -> None:
    across, *ups = table.lines
    x = [float(cell) for cell in table.column(across)]
    for number, name in enumerate(ups):
        y = [float(cell) for cell in table.column(name)]
        axis.plot(x, y, marker="o", label=name, color=f"C{number}")
    every = [float(cell) for name in ups for cell in table.column(name)]
    if max(x) > 20 * max(min(x), 1e-9):
        axis.set_xscale("log")
    if min(every) > 0 and math.log10(max(every) / min(every)) > 1.3:
        axis.set_yscale("log")
    else:
        axis.set_ylim(0, 1.15 * max(every))
    axis.set_xlabel(across, fontsize=8)
    axis.legend(fontsize=8, frameon=False)
    axis.tick_params(labelsize=8)
    axis.grid(alpha=0.3)
