"""The report on real pictures: real.json, real.md and real.html."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from simnfnd.evaluation.methods.method import shown
from simnfnd.evaluation.real.downstream import Segmented
from simnfnd.evaluation.real.measure import RealRow, mean_of
from simnfnd.evaluation.report.examples import as_data_uri
from simnfnd.evaluation.report.names import Metric, written
from simnfnd.evaluation.report.pages import own_file, render
from simnfnd.factory import markdown
from simnfnd.factory.files import write_atomically

COLUMNS = {
    "enl": Metric("ENL", 2, 0),
    "cnr": Metric("CNR dark ground", 3, 1),
    "object_cnr": Metric("CNR objects", 3, 1),
    "shadow_level": Metric("dark / bright", 3, -1),
    "edges_kept": Metric("edges kept", 3, 0),
    "ratio_mean": Metric("ratio mean", 3, 0),
    "m_index": Metric("M-index", 2, 0),
    "miou": Metric("mIoU", 3, 1),
}
RULES = (
    "No truth exists, so no figure alone says that one method is better than another: blur alone "
    "raises ENL and CNR, and doing nothing keeps all edges and has a low M-index. Read them "
    "together, and look at the pictures.",
    "Even zones are the tenth of all 16x16 blocks of the picture as it is with the least std / "
    "mean; dark ground is the darkest tenth and bright ground the brighter half of the sector by "
    "its 15-pixel median. They are the same for all methods. Objects, where masks tell them, are "
    "compared with the 15 pixels around.",
    "Edges kept and ratio mean are against the picture as it is, noise and all: 1 means unchanged.",
)


def write(
    out: Path,
    facts: Mapping[str, Any],
    rows: Sequence[RealRow],
    downstream: Mapping[str, Segmented],
    examples: Sequence[int],
) -> None:
    """Write the three files.  examples: numbers of the pictures to show.

    FactoryError when the folder cannot be written to.
    """
    lines = [_line(row, downstream.get(row.method.label)) for row in rows]
    content = {**facts, "rows": lines, "rules": RULES}
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_atomically(out / "real.json", text.encode(), durable=False, key="out")
    write_atomically(out / "real.md", _markdown(facts, lines).encode(), durable=False, key="out")
    page = _page(facts, lines, rows, examples)
    write_atomically(out / "real.html", page.encode(), durable=False, key="out")


def markdown_table(lines: Sequence[Mapping[str, Any]]) -> str:
    """The means, a line a method."""
    names = _names(lines)
    rows = []
    for line in lines:
        title = line["label"] + shown(line["parameters"])
        if line["lost"] is not None:
            rows.append([title, f"lost: {line['lost']}", *[""] * (len(names) - 1)])
        else:
            means = line["means"]
            rows.append([title, *(written(means[n], COLUMNS[n].digits) for n in names)])
    return markdown.table(["method", *(COLUMNS[name].label for name in names)], rows)


def _line(row: RealRow, segments: Segmented | None) -> dict[str, Any]:
    means = {name: mean_of(row, name) for name in COLUMNS if name != "miou"}
    means["miou"] = None if segments is None else segments.mean
    return {
        "label": row.method.label,
        "parameters": row.method.parameters,
        "lost": row.lost,
        "means": means,
        "class_iou": None if segments is None else segments.iou,
        "pictures": [
            {name: value if math.isfinite(value) else None for name, value in one.items()}
            for one in row.figures
        ],
    }


def _names(lines: Sequence[Mapping[str, Any]]) -> list[str]:
    return [name for name in COLUMNS if any(line["means"][name] is not None for line in lines)]


def _markdown(facts: Mapping[str, Any], lines: Sequence[Mapping[str, Any]]) -> str:
    return "\n\n".join(
        [f"# Real sonar: {facts['name']}", _about(facts), markdown_table(lines), *RULES, ""]
    )


def _about(facts: Mapping[str, Any]) -> str:
    return "; ".join([f"{len(facts['files'])} pictures", *facts["notes"]]) + "."


def _page(
    facts: Mapping[str, Any],
    lines: Sequence[Mapping[str, Any]],
    rows: Sequence[RealRow],
    examples: Sequence[int],
) -> str:
    alive = [row for row in rows if row.lost is None]
    return render(
        "real.html",
        css=own_file("page.css"),
        title=f"Real sonar: {facts['name']}",
        about=_about(facts),
        lines=lines,
        names=_names(lines),
        columns=COLUMNS,
        rules=RULES,
        strips=[
            (
                facts["files"][number],
                [(row.method.label, as_data_uri(row.images[number])) for row in alive],
            )
            for number in examples
        ],
    )
