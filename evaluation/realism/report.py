"""The comparison as a table, as JSON and as one HTML file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from markupsafe import Markup

from ..report.charts import as_svg
from ..report.page import as_data_uri, as_json, render, write_files
from ..report.tables import as_markdown, as_table, plain
from ..settings import RealismSettings
from .compare import REAL, STATISTICS, compare, overall
from .measure import measure
from .pictures import Collection, has_geometry, open_dataset, open_real

if TYPE_CHECKING:
    import pandas as pd

_OVERALL = {
    "geometric_mean_ratio": "mean ratio",
    "median_ratio": "median ratio",
    "within_2": "within 2 times",
}


def evaluate(settings: RealismSettings) -> None:
    """Measure, compare, print the table and write the report.  Raises FactoryError."""
    real = open_real(settings.real).at_most(settings.limit)
    collections = {REAL: real, **_simulations(settings)}
    measured = {name: measure(item, settings.grid) for name, item in collections.items()}
    compared = compare(
        measured.pop(REAL),
        measured,
        resamples=settings.resamples,
        halves=settings.halves,
        seed=settings.seed,
    )
    out = Path(settings.out or Path("outputs", "realism", next(iter(measured))))
    facts = _facts(settings, collections, compared)
    shown = table(compared)
    # Far range on top.
    pictures = {
        name: [as_data_uri(one.polar(settings.grid)[::-1]) for one in collection.at_most(8).sources]
        for name, collection in collections.items()
    }
    title, rule = f"Simulated against real: {facts['real']}", _explanation(facts)
    page = render(
        "realism.html",
        title=title,
        notes=facts["notes"],
        table=shown,
        explanation=rule,
        chart=_chart(compared),
        pictures=pictures,
    )
    notes = "".join(f"- {note}\n" for note in facts["notes"])
    markdown = f"# {title}\n\n{notes}\n{as_markdown(shown, 'llr')}\n\n{rule}\n"
    write_files(out, {"realism.json": as_json(facts), "realism.md": markdown, "realism.html": page})
    print(*facts["notes"], as_markdown(shown, "llr"), sep="\n")
    print(f"report: {out / 'realism.html'}")


def _simulations(settings: RealismSettings) -> dict[str, Collection]:
    """Name -> pictures; two folders of one name get a number."""
    found: dict[str, Collection] = {}
    for folder in settings.sim:
        path = Path(folder).expanduser()
        opened = (
            open_real(path)
            if has_geometry(path)
            else open_dataset(path, settings.sim_split, settings.layer)
        )
        name, number = opened.name, 2
        while name in found or name == REAL:
            name, number = f"{opened.name} {number}", number + 1
        found[name] = opened.at_most(settings.limit)
    return found


def _facts(
    settings: RealismSettings, collections: Mapping[str, Collection], compared: pd.DataFrame
) -> dict[str, Any]:
    names = [name for name in collections if name != REAL]
    statistics = {}
    for statistic, part in compared.groupby("statistic", sort=False):
        lines = {
            name: {key: plain(value) for key, value in line.items()}
            for name, line in part.set_index("against")[["mean", "low", "high"]].T.items()
        }
        about = STATISTICS[str(statistic)]
        statistics[statistic] = {
            "label": about.label,
            "unit": about.unit,
            "baseline": lines[REAL],
            "distance": {name: lines[name] for name in names},
            "ratio": {name: plain(part.set_index("against")["ratio"][name]) for name in names},
        }
    return {
        "real": collections[REAL].name,
        "pictures": {name: len(item.sources) for name, item in collections.items()},
        "notes": [note for item in collections.values() for note in item.notes],
        "grid": asdict(settings.grid),
        "layer": settings.layer,
        "halves": settings.halves,
        "half": min(len(item.sources) for item in collections.values()) // 2,
        "resamples": settings.resamples,
        "seed": settings.seed,
        "overall": {
            name: {key: plain(v) for key, v in overall(compared, name).items()} for name in names
        },
        "statistics": statistics,
    }


def _explanation(facts: Mapping[str, Any]) -> str:
    grid, halves, resamples = facts["grid"], facts["halves"], facts["resamples"]
    return (
        f"Everything is measured on polar pictures ({grid['range_bins']} range bins, "
        f"{grid['beams']} beams) that inverse mapping makes of the fans, on the grey values as "
        "they are shown. 'real' is the distance between two halves of the real pictures "
        f"({halves} halves), which a perfect simulation would reach; a ratio is a distance over "
        f"it. All sets in a comparison have one size ({facts['half']}). Figures are means of "
        f"{resamples} half samples; intervals, their 2.5 and 97.5 percentiles, are in the chart."
    )


def table(compared: pd.DataFrame) -> pd.DataFrame:
    """As text: the baseline, every simulation's distance, and how many times the baseline."""
    names = [name for name in compared["against"].unique() if name != REAL]
    head = ["real against", "unit", REAL, *(cell for name in names for cell in (name, "ratio"))]
    rows = []
    for statistic, part in compared.groupby("statistic", sort=False):
        found, about = part.set_index("against"), STATISTICS[str(statistic)]
        cells = [about.label, about.unit, number(found["mean"][REAL])]
        for name in names:
            cells += [number(found["mean"][name]), times(found["ratio"][name])]
        rows.append(cells)
    sums = [overall(compared, name) for name in names]
    for key, label in _OVERALL.items():
        form = "{:.0%}".format if key == "within_2" else times
        rows.append([label, "", "", *(cell for one in sums for cell in ("", form(one[key])))])
    return as_table(head, rows)


def _chart(compared: pd.DataFrame) -> Markup:
    """Distance over baseline of every statistic, logarithmic."""
    from matplotlib.figure import Figure  # a Figure needs no display

    statistics = list(compared["statistic"].unique())
    figure = Figure(figsize=(8.5, 0.9 + 0.32 * len(statistics)), layout="constrained")
    axis = figure.subplots()
    heights = np.arange(len(statistics))[::-1].astype(np.float64)
    axis.axvspan(1e-3, 2, color="black", alpha=0.1, lw=0)
    names = [name for name in compared["against"].unique() if name != REAL]
    for place, name in enumerate(names):
        rows = compared[compared["against"] == name]
        base = rows["mean"] / rows["ratio"]
        middle, low, high = ((rows[key] / base).clip(lower=0.05) for key in ("mean", "low", "high"))
        at = heights - 0.22 * (place - (len(names) - 1) / 2)
        bars = [(middle - low).clip(lower=0), (high - middle).clip(lower=0)]
        axis.errorbar(middle, at, xerr=bars, fmt="o", ms=5, label=name)
    axis.set(xscale="log", xlabel="distance to real over that of two halves of real (shaded: to 2)")
    labels = [STATISTICS[one] for one in statistics]
    axis.set_yticks(heights, [f"{one.label} {one.unit}".strip() for one in labels])
    axis.set_xlim(0.3, max(3.0, axis.get_xlim()[1]))
    axis.legend()
    return as_svg(figure, "distance over baseline")


def number(value: float) -> str:
    """Three digits, or a dash where there is no figure."""
    return f"{value:.3g}" if math.isfinite(value) else "-"


def times(value: float) -> str:
    """A ratio as people read it."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"
