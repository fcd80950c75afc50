"""report.html: the whole report in one file that needs no network and no server."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup

from ...factory.files import write_atomically
from . import curves, files
from .content import best_forms
from .examples import Example, as_data_uri
from .names import METRIC_NAMES
from .pages import own_file, render
from .paper import TABLE_METRICS

PAGE_NAME = "report.html"

Content = Mapping[str, Any]

_BOARD = ("psnr", "ssim", "gmsd", "psnr_fan", "shadow_iou")


def write(path: Path, content: Content, examples: Sequence[Example]) -> None:
    """Write the page.  FactoryError when its folder cannot be written to."""
    write_atomically(path, html(content, examples).encode(), key="out")


def html(content: Content, examples: Sequence[Example]) -> str:
    """The page as text."""
    facts, rows = content["facts"], content["rows"]
    board = [name for name in _BOARD if any(name in row["metrics"] for row in rows)]
    has_costs = any(row["gmac"] for row in rows)
    return render(
        "report.html",
        css=own_file("page.css"),
        script=own_file("page.js"),
        content=content,
        rows=rows,
        best=best_forms(rows),
        title=f"{facts['dataset']}, {facts['split']} split",
        about=(
            f"{facts['pairs']} pairs of {facts['frames']} frames in {len(facts['scenes'])} "
            f"scene(s), {facts['image']} pixels, config {facts['config_hash'] or 'unknown'}"
        ),
        board_metrics=board,
        # Method, the metrics, four columns about PSNR, time and cost.
        board_width=len(board) + 6 + has_costs,
        has_costs=has_costs,
        more_metrics=_measured(rows),
        paper_metrics=TABLE_METRICS,
        verdict=_verdict(content),
        examples=_data(examples),
        cost_curves=curves.cost(content),
        breakdown=[(entry, curves.gain(entry)) for entry in content["breakdown"]],
        robustness=content["robustness"],
        robustness_curve=curves.robustness(content),
    )


def _measured(rows: Sequence[Content]) -> list[str]:
    """The metrics that any row has figures of."""
    return [n for n in METRIC_NAMES if any(row["metrics"].get(n, {}).get("count") for row in rows)]


def _verdict(content: Content) -> list[tuple[str, bool]]:
    """The verdict in parts; true: a part is the name of a row."""
    parts = files.verdict(content).split("`")
    return [(part, bool(number % 2)) for number, part in enumerate(parts)]


def _data(examples: Sequence[Example]) -> Markup:
    """What the viewer shows, as JSON; empty without examples."""
    if not examples:
        return Markup("")
    data = [
        {
            "title": one.title,
            "images": {label: as_data_uri(image) for label, image in one.images.items()},
            "psnr": one.psnr,
        }
        for one in examples
    ]
    # "</script>" in a name would end the element.
    return Markup(json.dumps(data).replace("<", "\\u003c"))
