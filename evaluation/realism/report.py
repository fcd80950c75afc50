"""The comparison as a table, as JSON and as one HTML file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..report.page import as_data_uri, as_json, own_file, render, write_files
from ..report.tables import as_markdown, as_table, plain
from ..settings import RealismSettings
from .compare import Comparison, Interval, compare, overall
from .measure import Measured, measure
from .pictures import GEOMETRY_FILE, Collection, open_dataset, open_real
from .plots import distributions, ratios

_OVERALL = {
    "geometric_mean_ratio": "mean ratio",
    "median_ratio": "median ratio",
    "within_2": "within 2 times",
}


def evaluate(settings: RealismSettings) -> None:
    """Measure, compare, print the table and write the report.  Raises FactoryError."""
    real = open_real(settings.real).at_most(settings.limit)
    collections = {"real": real, **_simulations(settings)}
    measured = {name: measure(item, settings.grid) for name, item in collections.items()}
    comparisons = compare(
        measured["real"],
        {name: one for name, one in measured.items() if name != "real"},
        resamples=settings.resamples,
        halves=settings.halves,
        seed=settings.seed,
    )
    first = next(name for name in collections if name != "real")
    out = Path(settings.out or Path("outputs", "realism", first))
    write(out, settings, collections, measured, comparisons)
    for note in (note for item in collections.values() for note in item.notes):
        print(note)
    print(table(comparisons))
    print(f"report: {out / 'realism.html'}")


def _simulations(settings: RealismSettings) -> dict[str, Collection]:
    """Name -> pictures; two folders of one name get a number."""
    found: dict[str, Collection] = {}
    for folder in settings.sim:
        path = Path(folder).expanduser()
        pictures = (path / GEOMETRY_FILE).is_file() or (path / "Images").is_dir()
        opened = (
            open_real(path) if pictures else open_dataset(path, settings.sim_split, settings.layer)
        )
        name, number = opened.name, 2
        while name in found or name == "real":
            name, number = f"{opened.name} {number}", number + 1
        found[name] = opened.at_most(settings.limit)
    return found


def write(
    out: Path,
    settings: RealismSettings,
    collections: Mapping[str, Collection],
    measured: Mapping[str, Measured],
    comparisons: Sequence[Comparison],
) -> None:
    """Write realism.json, realism.md and realism.html into `out`.

    collections, measured: "real" first, then the simulations.  Raises FactoryError when the folder
    cannot be written.
    """
    facts = _facts(settings, collections, comparisons)
    # Far range on top.
    pictures = {
        name: [as_data_uri(one.polar(settings.grid)[::-1]) for one in collection.at_most(8).sources]
        for name, collection in collections.items()
    }
    page = render(
        "realism.html",
        {"number": number, "times": times},
        css=own_file("page.css"),
        title=f"Simulated against real: {facts['real']}",
        facts=facts,
        names=list(comparisons[0].distance),
        comparisons=comparisons,
        sums=sums(comparisons),
        explanation=_explanation(facts),
        ratios=ratios(comparisons),
        distributions=distributions(measured),
        pictures=pictures,
    )
    markdown = (
        f"# Simulated against real: {facts['real']}\n\n"
        + "".join(f"- {note}\n" for note in facts["notes"])
        + f"\n{table(comparisons)}\n\n{_explanation(facts)}\n"
    )
    write_files(out, {"realism.json": as_json(facts), "realism.md": markdown, "realism.html": page})


def _facts(
    settings: RealismSettings,
    collections: Mapping[str, Collection],
    comparisons: Sequence[Comparison],
) -> dict[str, Any]:
    names = list(comparisons[0].distance)
    return {
        "real": collections["real"].name,
        "pictures": {name: len(item.sources) for name, item in collections.items()},
        "notes": [note for item in collections.values() for note in item.notes],
        "grid": asdict(settings.grid),
        "layer": settings.layer,
        "halves": settings.halves,
        "half": min(len(item.sources) for item in collections.values()) // 2,
        "resamples": settings.resamples,
        "seed": settings.seed,
        "overall": {
            name: {key: plain(v) for key, v in overall(comparisons, name).items()} for name in names
        },
        "statistics": {
            item.statistic.name: {
                "label": item.statistic.label,
                "unit": item.statistic.unit,
                "what": item.statistic.what,
                "baseline": _interval(item.baseline),
                "distance": {name: _interval(item.distance[name]) for name in names},
                "ratio": {name: plain(item.ratio(name)) for name in names},
            }
            for item in comparisons
        },
    }


def _interval(interval: Interval) -> dict[str, float | None]:
    return {key: plain(value) for key, value in asdict(interval).items()}


def _explanation(facts: Mapping[str, Any]) -> str:
    grid, halves, resamples = facts["grid"], facts["halves"], facts["resamples"]
    return (
        f"Everything is measured on polar pictures ({grid['range_bins']} range bins, "
        f"{grid['beams']} beams) that inverse mapping makes of the fans, on the grey values as "
        "they are shown. 'real' is the distance between two halves of the real pictures "
        f"({halves} halves), which a perfect simulation would reach; a ratio is a distance over "
        f"it. All sets in a comparison have one size ({facts['half']}). Figures are means of "
        f"{resamples} half samples, intervals their 2.5 and 97.5 percentiles."
    )


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
    return as_markdown(as_table(head, rows), "llr")


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
