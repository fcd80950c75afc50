"""The report as files: report.json, the page, Markdown, LaTeX, CSV and pictures."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping, Sequence
from functools import lru_cache
from importlib.resources import files as resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ...factory.errors import FactoryError
from ...factory.files import explain_os_errors, write_atomically
from . import charts, tables
from .content import best_forms, verdict
from .measure import Example, Row
from .tables import METRIC_NAMES, as_markdown

if TYPE_CHECKING:
    import pandas as pd

    from ..pairs import Item

PAGE_NAME, REPORT_NAME, RESULTS_NAME = "report.html", "report.json", "results.csv"

Content = Mapping[str, Any]

_BOARD = ("psnr", "ssim", "gmsd", "psnr_fan", "shadow_iou")


def write_results(
    path: Path, rows: Sequence[Row], items: Sequence[Item], drawn: Mapping[str, npt.NDArray[Any]]
) -> None:
    """results.csv: a line for each row of the report and pair, with what was drawn for it."""
    import pandas as pd

    own = ("location", "scene", "frame", "variant")
    pairs = pd.DataFrame(
        [(i.shard, i.place[1], i.key, i.location, i.scene, i.frame, i.variant) for i in items],
        columns=["shard", "index", "pair", *own],
    )
    more = pd.DataFrame({name: values for name, values in drawn.items() if name not in pairs})
    parts = []
    for row in rows:
        if row.lost is None:
            part = pd.concat([pairs, pd.DataFrame(row.values), more], axis=1)
            part.insert(0, "method", row.method.label)
            parts.append(part)
    content = pd.concat(parts).to_csv(index=False, lineterminator="\n")
    write_atomically(path, content.encode(), key="out")


def read_results(folder: Path) -> pd.DataFrame:
    """The table of a report's results.csv.  FactoryError when there is none."""
    import pandas as pd

    path = folder / RESULTS_NAME
    if not path.is_file():
        raise FactoryError(
            f"{folder}: no report here (no {RESULTS_NAME}); make one with "
            "`simnfnd evaluate dataset=DIR`"
        )
    words = ("method", "shard", "pair", "location", "scene", "frame")
    try:
        table = pd.read_csv(
            path, float_precision="round_trip", dtype=dict.fromkeys(words, str), low_memory=False
        )
        table[[*words, "psnr"]].astype({"psnr": float})
    except (OSError, ValueError, KeyError) as error:
        reason = " ".join(str(error).split())[:80]
        raise FactoryError(
            f"{path}: damaged or of another version ({reason}); make it again"
        ) from error
    return table.fillna(dict.fromkeys(words, ""))


def write(out: Path, content: Content, examples: Sequence[Example]) -> None:
    """report.json, report.md, report.html and leaderboard.tex.

    Raises FactoryError when the folder cannot be written to.
    """
    rows = content["rows"]
    write_files(
        out,
        {
            REPORT_NAME: as_json(content),
            PAGE_NAME: html(content, examples),
            "report.md": markdown(content),
            "leaderboard.tex": tables.as_latex(rows),
        },
    )


def write_files(out: Path, files: Mapping[str, str | bytes]) -> None:
    """Name -> content, each whole or not at all.  FactoryError where the folder cannot be made."""
    with explain_os_errors(out, "out"):
        out.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        data = content.encode() if isinstance(content, str) else content
        write_atomically(out / name, data, key="out")


def as_json(content: Content) -> str:
    """JSON as reports write it."""
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def as_data_uri(image: npt.NDArray[np.float32]) -> str:
    """The picture, (H, W) in 0..1, in 8 bits as a lossless data: URI."""
    pixels = np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
    _, content = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    return "data:image/png;base64," + base64.b64encode(content.tobytes()).decode("ascii")


def markdown(content: Content) -> str:
    """The whole report in Markdown."""
    facts, rows = content["facts"], content["rows"]
    parts = [
        f"# Report: {facts['dataset']}, {facts['split']} split",
        f"{_about(facts)}.",
        "## Leaderboard",
        *folded(rows),
        facts["few_frames"],
        verdict(content),
    ]
    if len(best_forms(rows)) < len(rows):
        parts += ["## All forms", as_markdown(tables.leaderboard(rows))]
    for number, table, order in (("2", "table_2", "ordering"), ("3", "table_3", "ordering_3")):
        if content[order]:
            lines = "\n".join(f"- {line}" for line in content[order])
            table_ = as_markdown(tables.beside_paper(content[table]), "lrrl")
            parts += [f"## The paper's Table {number}", table_, lines]
    parts += ["## More metrics", as_markdown(tables.more_metrics(rows))]
    if content["breakdown"]:
        parts.append("## Mean PSNR in dB by place, noise and resampling (number of pairs)")
        parts += [as_markdown(table) for table in _breakdown(content)]
    parts += ["## How it was measured", *facts["rules"]]
    return "\n\n".join(filter(None, parts)) + "\n"


def folded(rows: Sequence[Content]) -> list[str]:
    """The leaderboard of the best form of each method, and how many it leaves out."""
    best = best_forms(rows)
    more = len(rows) - len(best)
    note = f"Of each method its best form here; {more} more in report.md." if more else ""
    return [as_markdown(tables.leaderboard(best)), *filter(None, [note])]


def html(content: Content, examples: Sequence[Example]) -> str:
    """The page: one file that needs no network and no server."""
    facts, rows = content["facts"], content["rows"]
    board = [name for name in _BOARD if any(name in row["metrics"] for row in rows)]
    has_costs = any(row["gmac"] for row in rows)
    return render(
        "report.html",
        content=content,
        rows=rows,
        best=best_forms(rows),
        title=f"{facts['dataset']}, {facts['split']} split",
        about=_about(facts),
        board_metrics=board,
        # Method, the metrics, four columns about PSNR, time and cost.
        board_width=len(board) + 6 + has_costs,
        has_costs=has_costs,
        more_metrics=[name for name in METRIC_NAMES if tables.has(rows, name)],
        paper=[tables.beside_paper(content[name]) for name in ("table_2", "table_3")],
        # In parts; every second one is the name of a row.
        verdict=[(part, bool(n % 2)) for n, part in enumerate(verdict(content).split("`"))],
        examples=_data(examples),
        cost_curves=charts.cost(content),
        breakdown=_breakdown(content),
    )


def _about(facts: Content) -> str:
    return (
        f"{facts['pairs']} pairs of {facts['frames']} frames in {len(facts['scenes'])} scene(s) "
        f"({facts['image']}; config {facts['config_hash'] or 'unknown'})"
    )


def _breakdown(content: Content) -> list[pd.DataFrame]:
    return [tables.as_table(one["columns"], one["data"]) for one in content["breakdown"]]


def render(template: str, **values: Any) -> str:
    """A page of templates/ as text, everything from outside escaped."""
    return _environment().get_template(template).render(**values).lstrip()


def own_file(name: str) -> Markup:
    """A style sheet or script of this folder, to stand in a page as it is."""
    return Markup(resources("simnfnd.evaluation.report").joinpath(name).read_text(encoding="utf-8"))


def _data(examples: Sequence[Example]) -> Markup:
    """What the viewer of the page shows, as JSON; empty without examples."""
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


@lru_cache(maxsize=1)
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("simnfnd.evaluation.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals |= {"METRICS": METRIC_NAMES, "own_file": own_file}
    names = ("chosen", "interval", "percent", "written", "written_p")
    environment.filters |= {name: getattr(tables, name) for name in names}
    return environment
