"""table.html and table.md of a benchmark."""

from __future__ import annotations

from collections.abc import Sequence

from ...factory.files import write_atomically
from ..report.pages import own_file, render
from . import table
from .folder import Benchmark
from .results import Result

PAGE, TEXT = "table.html", "table.md"

RULES = (
    "Every method gets the noisy pictures and geometry.csv, and nothing of references/. It may be "
    "tuned on practice/ and trained on anything but the places 9000 to 9999 and the recordings "
    "below. One set of weights or one program enters for all sets; if its parameters differ "
    "between sets, they are those that practice/ chose.",
    "Everything is judged in 8 bits. Brackets hold 95 % bootstrap intervals that draw whole "
    "scenes; the test is Wilcoxon's signed-rank test over scenes against the filter with the best "
    "mean here, with Holm's correction over the rows. Figures after levels are after one gain and "
    "offset a picture, inside the sector. ENL, edges and M-index do not rank methods alone.",
    "Real pictures are compared with the mean of the other frames of a scene that stands still.",
    "CPU seconds a picture are those of the machine that entered the method, the median.",
)


def write(benchmark: Benchmark, results: Sequence[Result]) -> str:
    """Write both files; returns the text.  FactoryError when they cannot be written."""
    text = table.as_markdown(benchmark, results)
    write_atomically(benchmark.root / TEXT, text.encode(), durable=False, key="--benchmark")
    page = html(benchmark, results)
    write_atomically(benchmark.root / PAGE, page.encode(), durable=False, key="--benchmark")
    return text


def html(benchmark: Benchmark, results: Sequence[Result]) -> str:
    """The page as text."""
    found = table.tables(benchmark, results)
    overview = table.overview(found)
    sets = [
        {
            "name": one.pictures.name,
            "about": one.about,
            "head": table.head(one),
            "rows": [
                {"cells": table.cells(one, row), "filter": row.result.method.kind == "baseline"}
                for row in one.rows
            ],
        }
        for one in found
    ]
    return render(
        "benchmark.html",
        css=own_file("page.css"),
        title=f"Benchmark of sonar denoisers, version {benchmark.manifest.version}",
        overview=overview,
        sets=sets,
        results=results,
        digests=table.digests(found),
        rules=RULES,
    )
