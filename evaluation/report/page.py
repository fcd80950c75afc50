"""report.html: the whole report in one file that needs no network and no server."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files as resources
from pathlib import Path
from typing import Any

from simnfnd.evaluation.methods.method import shown
from simnfnd.evaluation.report import files, sections, tables
from simnfnd.evaluation.report.examples import Example, as_data_uri
from simnfnd.evaluation.report.markup import cell, first, head, paragraph
from simnfnd.evaluation.report.names import METRIC_NAMES, written, written_p
from simnfnd.factory.files import write_atomically

PAGE_NAME = "report.html"

Content = Mapping[str, Any]

_BOARD = ("psnr", "ssim", "gmsd", "psnr_fan", "shadow_iou")


def write(path: Path, content: Content, examples: Sequence[Example]) -> None:
    """Write the page.  FactoryError when its folder cannot be written to."""
    write_atomically(path, html(content, examples).encode(), key="out")


def html(content: Content, examples: Sequence[Example]) -> str:
    """The page as text."""
    facts = content["facts"]
    title = f"{facts['dataset']}, {facts['split']} split"
    parts = [
        ("Leaderboard", _board(content["rows"]) + _verdict(content)),
        ("Look at it", _viewer(examples)),
        ("Quality against cost", sections.cost(content)),
        ("The paper's tables", sections.paper(content)),
        ("Where it is good and where not", sections.breakdown(content["breakdown"])),
        ("Other noise", sections.robustness(content)),
        ("More metrics", sections.more(content["rows"])),
        ("How it was measured", "".join(paragraph(rule) for rule in facts["rules"])),
    ]
    body = "".join(f"<section><h2>{name}</h2>{text}</section>" for name, text in parts if text)
    about = (
        f"{facts['pairs']} pairs of {facts['frames']} frames in {len(facts['scenes'])} scene(s), "
        f"{facts['image']} pixels, config {facts['config_hash'] or 'unknown'}"
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="data:,">'
        f"<title>Denoising report: {escape(title)}</title><style>{_resource('page.css')}</style>"
        f"</head><body><header><div><h1>Denoising report: {escape(title)}</h1>"
        f'<p class="soft">{escape(about)}</p></div>'
        '<button class="plain" id="theme" type="button">Light / dark</button></header>'
        f'<main>{body}<footer class="soft">Method and Tables 2 and 3: Yang, Zhang and Yao, '
        "Remote Sensing 16(15), 2815, 2024. Made by SimNFND.</footer></main>"
        f"{_data(examples)}<script>{_resource('page.js')}</script></body></html>\n"
    )


def _board(rows: Sequence[Content]) -> str:
    names = [name for name in _BOARD if any(name in row["metrics"] for row in rows)]
    heads = [head("method", "ascending", left=True)]
    for name in names:
        heads.append(head(METRIC_NAMES[name].label, first(name)))
        if name == "psnr":
            heads += ["<th>95 % interval</th>", head("against noisy, dB", "descending")]
            heads += [head("p (Holm)", "ascending"), head("wins", "descending")]
    costs = any(row["gmac"] for row in rows)
    heads += [head("ms", "ascending"), *([head("GMAC", "ascending")] if costs else [])]
    lines = [_board_row(row, names, len(heads), costs) for row in rows]
    return (
        '<div class="scroll" tabindex="0" role="region" aria-label="leaderboard">'
        f'<table class="board sortable"><thead><tr>{"".join(heads)}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
        '<p class="soft">A click on a column\'s head sorts by it; again, the other way.</p>'
    )


def _board_row(row: Content, names: Sequence[str], width: int, costs: bool) -> str:
    parameters = shown(row["parameters"]).strip(" ()")
    if row["levels"]:
        levels = "gain {gain:.2f}, offset {offset:+.3f}".format(**row["levels"])
        parameters = f"{parameters}; {levels}" if parameters else levels
    small = f"<small>{escape(parameters)}</small>" if parameters else ""
    title = (
        f'<td data-value="{escape(row["label"], quote=True)}">{escape(row["label"])}{small}</td>'
    )
    if row["lost"] is not None:
        why = f'<td class="left" colspan="{width - 1}">lost: {escape(row["lost"])}</td>'
        return f'<tr class="lost">{title}{why}</tr>'
    cells = [title]
    for name in names:
        item = row["metrics"][name]
        cells.append(cell(item["mean"], written(item["mean"], METRIC_NAMES[name].digits)))
        if name == "psnr":
            cells.append(f"<td>{tables.interval(item, 2)}</td>")
            gain = row["against_noisy"].get("psnr") or {}
            mean = gain.get("mean")
            cells.append(cell(mean, written(mean, 2, True) if gain else ""))
            cells.append(cell(gain.get("p_holm"), written_p(gain["p_holm"]) if gain else ""))
            cells.append(cell(gain.get("wins"), tables.percent(gain["wins"]) if gain else ""))
    cells.append(cell(row["milliseconds"], written(row["milliseconds"], 1)))
    if costs:
        cells.append(cell(row["gmac"], written(row["gmac"], 2) if row["gmac"] else ""))
    return f'<tr class="{row["kind"]}">{"".join(cells)}</tr>'


def _verdict(content: Content) -> str:
    """The verdict, with the names of rows in bold."""
    parts = escape(files.verdict(content)).split("`")
    bold = (f"<b>{part}</b>" if number % 2 else part for number, part in enumerate(parts))
    return f"<p>{''.join(bold)}</p>"


def _viewer(examples: Sequence[Example]) -> str:
    if not examples:
        return ""
    maps = {
        "image": "pictures",
        "error": "error against clean",
        "signed": "signed error",
        "ratio": "ratio noisy / picture",
    }
    options = "".join(f'<option value="{key}">{text}</option>' for key, text in maps.items())
    return (
        '<div class="viewer"><div class="controls">'
        '<label>Pair<select id="pair"></select></label>'
        '<label>Left<select id="before"></select></label>'
        '<label>Right<select id="after"></select></label>'
        f'<label>Show<select id="map">{options}</select></label>'
        '<button class="plain" id="farther" type="button" aria-label="zoom out">−</button>'
        '<output id="zoom">100 %</output>'
        '<button class="plain" id="closer" type="button" aria-label="zoom in">+</button>'
        '<button class="plain" id="whole" type="button">whole</button></div>'
        '<div class="stage" tabindex="0" role="application" aria-label="two pictures one over the '
        'other; arrows move the slider, plus and minus zoom, 0 shows the whole">'
        '<div class="layer first"><canvas></canvas></div>'
        '<div class="layer second"><canvas></canvas></div>'
        '<div class="divider"></div><span class="tag before"></span><span class="tag after"></span>'
        '</div><input type="range" id="slider" min="0" max="100" step="0.5" value="50" '
        'aria-label="how much of the left picture is shown, per cent">'
        '<p class="soft" id="said"></p>'
        '<p class="soft hint">Drag the picture or the slider. Zoom with the buttons, the keys + '
        "and −, or Ctrl and the wheel; then drag to move.</p></div>"
    )


def _data(examples: Sequence[Example]) -> str:
    if not examples:
        return ""
    data = [
        {
            "title": one.title,
            "images": {label: as_data_uri(image) for label, image in one.images.items()},
            "psnr": one.psnr,
        }
        for one in examples
    ]
    # "</script>" in a name would end the element.
    text = json.dumps(data).replace("<", "\\u003c")
    return f'<script type="application/json" id="examples">{text}</script>'


def _resource(name: str) -> str:
    return resources("simnfnd.evaluation.report").joinpath(name).read_text(encoding="utf-8")
