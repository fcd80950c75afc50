"""The comparison as a table, as JSON and as one HTML file."""

from __future__ import annotations

import base64
import html
import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from simnfnd.evaluation.realism.compare import Comparison, Interval, overall
from simnfnd.evaluation.realism.measure import Measured
from simnfnd.evaluation.realism.pictures import Collection
from simnfnd.evaluation.realism.plots import draw_all
from simnfnd.evaluation.realism.settings import RealismSettings
from simnfnd.factory.errors import FactoryError


def table(comparisons: Sequence[Comparison]) -> str:
    """Markdown: the baseline, every simulation's distance, and how many times the baseline."""
    names = list(comparisons[0].distance)
    head = ["real against", "unit", "real", *(cell for name in names for cell in (name, "ratio"))]
    lines = [_line(head), "|---|---|---:|" + "---:|---:|" * len(names)]
    for item in comparisons:
        cells = [item.statistic.label, item.statistic.unit, number(item.baseline.mean)]
        for name in names:
            cells += [number(item.distance[name].mean), times(item.ratio(name))]
        lines.append(_line(cells))
    sums = {name: overall(comparisons, name) for name in names}
    for key, label in _OVERALL.items():
        cells = [f"**{label}**", "", ""]
        for name in names:
            cells += ["", _summary(key, sums[name][key])]
        lines.append(_line(cells))
    return "\n".join(lines)


_OVERALL = {
    "geometric_mean_ratio": "mean ratio",
    "median_ratio": "median ratio",
    "within_2": "within 2 times",
}


def _summary(key: str, value: float) -> str:
    return f"{value:.0%}" if key == "within_2" and math.isfinite(value) else times(value)


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def number(value: float) -> str:
    """Three digits, or a dash where there is no figure."""
    return f"{value:.3g}" if math.isfinite(value) else "-"


def times(value: float) -> str:
    """A ratio as people read it."""
    if not math.isfinite(value):
        return "-"
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"


def write(
    out: Path,
    settings: RealismSettings,
    collections: Mapping[str, Collection],
    measured: Mapping[str, Measured],
    comparisons: Sequence[Comparison],
) -> None:
    """Write realism.json, realism.md, realism.html and the plots into `out`.

    collections, measured: "real" first, then the simulations.  Raises FactoryError when the folder
    cannot be written.
    """
    facts = _facts(settings, collections, comparisons)
    pictures = {
        name: [source.polar(settings.grid) for source in collection.at_most(8).sources]
        for name, collection in collections.items()
    }
    try:
        out.mkdir(parents=True, exist_ok=True)
        text = json.dumps(facts, indent=2, allow_nan=False)
        (out / "realism.json").write_text(text + "\n", encoding="utf-8")
        (out / "realism.md").write_text(_markdown(facts, comparisons), encoding="utf-8")
        plots = draw_all(out, comparisons, measured, pictures)
        (out / "realism.html").write_text(_page(out, facts, comparisons, plots), encoding="utf-8")
    except OSError as error:
        raise FactoryError(
            f"out={out}: cannot write there ({error.strerror or error}); choose another out="
        ) from error


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
        "grid": {"range_bins": settings.grid.range_bins, "beams": settings.grid.beams},
        "layer": settings.layer,
        "halves": settings.halves,
        "half": min(len(item.sources) for item in collections.values()) // 2,
        "resamples": settings.resamples,
        "seed": settings.seed,
        "overall": {
            name: {key: _finite(v) for key, v in overall(comparisons, name).items()}
            for name in names
        },
        "statistics": {
            item.statistic.name: {
                "label": item.statistic.label,
                "unit": item.statistic.unit,
                "what": item.statistic.what,
                "baseline": _interval(item.baseline),
                "distance": {name: _interval(item.distance[name]) for name in names},
                "ratio": {name: _finite(item.ratio(name)) for name in names},
            }
            for item in comparisons
        },
    }


def _interval(interval: Interval) -> dict[str, float | None]:
    return {key: _finite(getattr(interval, key)) for key in ("mean", "low", "high")}


def _finite(value: float) -> float | None:
    """JSON has no NaN."""
    return value if math.isfinite(value) else None


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


def _markdown(facts: Mapping[str, Any], comparisons: Sequence[Comparison]) -> str:
    notes = "".join(f"- {note}\n" for note in facts["notes"])
    return (
        f"# Simulated against real: {facts['real']}\n\n{notes}\n{table(comparisons)}\n\n"
        f"{_explanation(facts)}\n"
    )


_STYLE = """
:root { color-scheme: light dark; --paper: #fff; --ink: #1a1a1a; --muted: #666; --line: #ddd;
  --good: #0f7a50; }
@media (prefers-color-scheme: dark) {
  :root { --paper: #16181c; --ink: #ececec; --muted: #a5a5a5; --line: #3a3d44; --good: #4fd0a0; } }
body { background: var(--paper); color: var(--ink); font: 15px/1.5 system-ui, sans-serif;
  max-width: 75rem; margin: 2rem auto; padding: 0 1rem; }
p, li { max-width: 50rem; } .muted, td small { color: var(--muted); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; border-bottom: 1px solid var(--line); text-align: right; }
th:first-child, td:first-child { text-align: left; } thead th { vertical-align: bottom; }
td.near { color: var(--good); font-weight: 600; } tfoot td { font-weight: 600; }
img { max-width: 100%; height: auto; } h2 { margin-top: 2rem; }
"""
_TITLES = {
    "ratios": "Distance over baseline",
    "distributions": "What lies behind it",
    "pictures": "Examples: polar pictures, far range on top",
}


def _page(
    out: Path, facts: Mapping[str, Any], comparisons: Sequence[Comparison], plots: Sequence[str]
) -> str:
    """One file with everything in it: it can be sent by mail."""
    names = list(comparisons[0].distance)
    escaped = [html.escape(name) for name in names]
    head = "".join(f"<th>{name}</th><th>ratio</th>" for name in escaped)
    rows = []
    for item in comparisons:
        cells = [
            f'<td title="{html.escape(item.statistic.what)}">{html.escape(item.statistic.label)} '
            f"<small>{html.escape(item.statistic.unit)}</small></td>",
            f"<td>{_with_interval(item.baseline)}</td>",
        ]
        for name in names:
            ratio = item.ratio(name)
            near = ' class="near"' if ratio <= 2 else ""
            cells.append(f"<td>{_with_interval(item.distance[name])}</td>")
            cells.append(f"<td{near}>{times(ratio)}</td>")
        rows.append(f"<tr>{''.join(cells)}</tr>")
    sums = {name: overall(comparisons, name) for name in names}
    feet = [
        f"<tr><td>{label}</td><td></td>"
        + "".join(f"<td></td><td>{_summary(key, sums[name][key])}</td>" for name in names)
        + "</tr>"
        for key, label in _OVERALL.items()
    ]
    images = "".join(
        f"<h2>{_TITLES[name]}</h2><picture>"
        f'<source media="(prefers-color-scheme: dark)" srcset="{_inline(out, name + "-dark")}">'
        f'<img alt="{_TITLES[name]}" src="{_inline(out, name)}"></picture>'
        for name in plots
    )
    notes = "".join(f"<li>{html.escape(note)}</li>" for note in facts["notes"])
    title = f"Simulated against real: {html.escape(str(facts['real']))}"
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{_STYLE}</style></head><body><h1>{title}</h1><ul>{notes}</ul>"
        f'<div class="scroll"><table><thead><tr><th>distance of real to</th><th>real</th>{head}'
        f"</tr></thead><tbody>{''.join(rows)}</tbody><tfoot>{''.join(feet)}</tfoot></table></div>"
        f'<p class="muted">{html.escape(_explanation(facts))} Ratios up to 2 are green.</p>'
        f"{images}</body></html>\n"
    )


def _with_interval(interval: Interval) -> str:
    if not math.isfinite(interval.mean):
        return "-"
    return f"{number(interval.mean)} <small>{number(interval.low)}..{number(interval.high)}</small>"


def _inline(out: Path, name: str) -> str:
    data = base64.b64encode((out / f"{name}.png").read_bytes()).decode()
    return f"data:image/png;base64,{data}"
