"""The report on real pictures: real.json, real.md and real.html."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files as resources
from pathlib import Path
from typing import Any

from simnfnd.evaluation.methods.method import shown
from simnfnd.evaluation.real.downstream import Segmented
from simnfnd.evaluation.real.measure import RealRow, mean_of
from simnfnd.evaluation.report.examples import as_data_uri
from simnfnd.evaluation.report.markup import cell, paragraph, table
from simnfnd.evaluation.report.names import Metric, written
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
    head = ["method", *(COLUMNS[name].label for name in names)]
    text = [_row(head), "|---|" + "---:|" * len(names)]
    for line in lines:
        title = line["label"] + shown(line["parameters"])
        if line["lost"] is not None:
            text.append(_row([title, f"lost: {line['lost']}", *[""] * (len(names) - 1)]))
        else:
            means = line["means"]
            text.append(_row([title, *(written(means[n], COLUMNS[n].digits) for n in names)]))
    return "\n".join(text)


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


def _row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(str(cell).replace("|", "/") for cell in cells) + " |"


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
    names = _names(lines)
    head = "".join(f"<th>{escape(text)}</th>" for text in ("method", *_labels(names)))
    body = []
    for line in lines:
        small = f"<small>{escape(shown(line['parameters']).strip(' ()'))}</small>"
        title = f"<td>{escape(line['label'])}{small}</td>"
        if line["lost"] is not None:
            cells = f'<td class="left" colspan="{len(names)}">lost: {escape(line["lost"])}</td>'
        else:
            values = ((line["means"][name], COLUMNS[name].digits) for name in names)
            cells = "".join(cell(value, written(value, digits)) for value, digits in values)
        body.append(f"<tr>{title}{cells}</tr>")
    css = resources("simnfnd.evaluation.report").joinpath("page.css").read_text(encoding="utf-8")
    title = escape(f"Real sonar: {facts['name']}")
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<link rel="icon" href="data:,"><title>{title}</title><style>{css}{_STYLE}</style></head>'
        f"<body><header><div><h1>{title}</h1><p class='soft'>{escape(_about(facts))}</p></div>"
        f"</header><main><section><h2>Figures without a truth</h2>{table(head, body)}</section>"
        f"<section><h2>How to read them</h2>{''.join(map(paragraph, RULES))}</section>"
        f"{_pictures(facts, rows, examples)}</main><script>{_DARK}</script></body></html>\n"
    )


_DARK = (
    "if (matchMedia('(prefers-color-scheme: dark)').matches) "
    "document.documentElement.dataset.theme = 'dark'"
)
_STYLE = (
    ".strip{display:flex;gap:.6rem;overflow-x:auto;margin-bottom:1rem}"
    ".strip figure{margin:0;flex:0 0 auto}.strip img{height:24rem;display:block}"
)


def _labels(names: Sequence[str]) -> list[str]:
    return [COLUMNS[name].label for name in names]


def _pictures(facts: Mapping[str, Any], rows: Sequence[RealRow], examples: Sequence[int]) -> str:
    strips = []
    for number in examples:
        shown_here = "".join(
            f'<figure><img alt="{escape(row.method.label, quote=True)}" '
            f'src="{as_data_uri(row.images[number])}"><figcaption>{escape(row.method.label)}'
            "</figcaption></figure>"
            for row in rows
            if row.lost is None
        )
        name = escape(facts["files"][number])
        strips.append(f'<h3>{name}</h3><div class="strip" tabindex="0">{shown_here}</div>')
    return f"<section><h2>Look at them</h2>{''.join(strips)}</section>" if strips else ""
