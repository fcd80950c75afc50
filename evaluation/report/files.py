"""The report as files: per-image Parquet, JSON, and the tables."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.dataset.describe import markdown
from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ..data.pairs import Item
from ..measurement.rows import Row
from ..metrics import fidelity as metrics
from . import tables
from .content import SCHEMA, best_forms
from .names import written_p

RESULTS_NAME = "results.parquet"
REPORT_NAME = "report.json"


def write_results(
    path: Path, rows: Sequence[Row], items: Sequence[Item], drawn: Mapping[str, npt.NDArray[Any]]
) -> None:
    """results.parquet: a line for each row of the report and pair, with what was drawn for it."""
    arrow, parquet = _arrow()
    alive = [row for row in rows if row.lost is None]
    names = list(alive[0].values)
    count = len(items)
    columns: dict[str, Any] = {
        "method": np.repeat([row.method.label for row in alive], count),
        "shard": [item.shard for item in items] * len(alive),
        "index": [item.place[1] for item in items] * len(alive),
        "pair": [item.key for item in items] * len(alive),
    }
    for name in ("location", "scene", "frame", "variant"):
        columns[name] = [getattr(item, name) for item in items] * len(alive)
    for name in names:
        columns[name] = np.concatenate([row.values[name] for row in alive])
    for name, values in drawn.items():
        if name not in columns:
            columns[name] = np.tile(values, len(alive))
    sink = arrow.BufferOutputStream()
    parquet.write_table(arrow.table(columns), sink, compression="zstd")
    write_atomically(path, sink.getvalue().to_pybytes(), key="out")


def read_results(folder: Path) -> dict[str, Any]:
    """Column -> values of a report's results.parquet.  FactoryError when there is none."""
    path = folder / RESULTS_NAME
    if not path.is_file():
        raise FactoryError(f"{folder}: no report here (no {RESULTS_NAME}); make one with "
                           "`simnfnd evaluate dataset=DIR`")  # fmt: skip
    arrow, parquet = _arrow()
    try:
        table = parquet.read_table(path)
        lacking = {"method", "pair", "location", "scene", "frame", "psnr"} - set(table.column_names)
        if lacking or not table.num_rows:
            raise ValueError(f"lacks {', '.join(sorted(lacking)) or 'rows'}")
    except (arrow.ArrowException, OSError, ValueError) as error:
        reason = " ".join(str(error).split())[:80]
        raise FactoryError(
            f"{path}: damaged or of another version ({reason}); make it again"
        ) from error
    return {name: table[name].to_numpy(zero_copy_only=False) for name in table.column_names}


def read_content(folder: Path) -> dict[str, Any]:
    """The content of a report's report.json.  FactoryError when there is none."""
    path = folder / REPORT_NAME
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise ValueError(f"schema {content['schema']!r}")
        return content
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FactoryError(f"{path}: absent or damaged; make the report again") from error


def write_content(folder: Path, content: Mapping[str, Any]) -> None:
    """report.json, report.md, leaderboard.md, .tex and .csv."""
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    rows = content["rows"]
    files = {
        REPORT_NAME: text,
        "report.md": as_markdown(content),
        "leaderboard.md": tables.leaderboard(rows) + "\n",
        "leaderboard.tex": tables.latex(rows),
        "leaderboard.csv": tables.as_csv(rows),
    }
    for name, written in files.items():
        write_atomically(folder / name, written.encode(), key="out")


def as_markdown(content: Mapping[str, Any]) -> str:
    """The whole report in Markdown."""
    facts, rows = content["facts"], content["rows"]
    parts = [
        f"# Report: {facts['dataset']}, {facts['split']} split",
        f"{facts['pairs']} pairs of {facts['frames']} frames in {len(facts['scenes'])} scene(s) "
        f"({facts['image']}; config {facts['config_hash'] or 'unknown'}).",
        "## Leaderboard",
        *folded(rows),
        facts["few_frames"],
        verdict(content),
        *unfolded(rows),
        "## More metrics",
        tables.more_metrics(rows),
        "## The paper's Table 2",
        tables.beside_paper(content["table_2"]),
        "\n".join(f"- {line}" for line in content["ordering"]),
    ]
    if content["ordering_3"]:
        parts += ["## The paper's Table 3", tables.beside_paper(content["table_3"])]
        parts.append("\n".join(f"- {line}" for line in content["ordering_3"]))
    if content["breakdown"]:
        parts.append("## Mean PSNR in dB by place, noise and resampling (number of pairs)")
        parts += [tables.breakdown(entry) for entry in content["breakdown"]]
    if content["robustness"]:
        parts += ["## Other noise", *(_robustness(entry) for entry in content["robustness"])]
    parts += ["## How it was measured", *content["facts"]["rules"]]
    return "\n\n".join(filter(None, parts)) + "\n"


def folded(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The leaderboard of the best form of each method, and how many it leaves out."""
    best = best_forms(rows)
    more = len(rows) - len(best)
    note = f"Of each method its best form here; {more} more in leaderboard.md." if more else ""
    return [tables.leaderboard(best), *filter(None, [note])]


def unfolded(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """All forms, where some were left out above."""
    if len(best_forms(rows)) == len(rows):
        return []
    return ["## All forms", tables.leaderboard(rows)]


def verdict(content: Mapping[str, Any]) -> str:
    """What the networks give beyond the best baseline, in words."""
    best = content["best_classical"]
    if best["row"] is None:
        return "No baseline was measured."
    lines = [
        f"The best classical row of one look is `{best['row']}`, chosen on {best['chosen_on']}."
    ]
    for row in content["rows"]:
        margin = row["against_best"].get("psnr")
        if margin is not None:
            p = written_p(margin["p_holm"])
            lines.append(
                f"`{row['label']}` is {margin['mean']:+.2f} dB from it "
                f"({tables.interval(margin, 2)}; Wilcoxon-Holm p {p}; better in "
                f"{tables.percent(margin['wins'])} of the pairs)."
            )
    return " ".join(lines)


def rules(content_facts: Mapping[str, Any]) -> list[str]:
    """How figures were made, a paragraph each."""
    return [
        "Intervals: 95 % bootstrap that draws whole frames. Wilcoxon: signed ranks of the frames' "
        "mean differences, Holm's correction over the rows. Wins: share of pairs where the row "
        "is better.",
        f"PSNR: mean of the dB values of the images; identical pairs "
        f"({content_facts['identical_pairs']} here) count as {metrics.PSNR_CAP_DB:g} dB. SSIM: "
        "Gaussian window, sigma 1.5. GMSD: 2x2 mean first, c = 170 on 0..255; `as printed` in the "
        "paper: without the 2x2 mean. A pixel is shadow at or below "
        f"{content_facts['shadow_threshold']:g} of full scale.",
        "`+ levels`: one gain and offset for all images; they and the parameters of `tuned` come "
        "from validation pairs. ms: median CPU time of one image (of networks on a GPU: elapsed "
        "time); other processes can still slow it down through shared caches.",
    ]


def facts_of(
    settings: Any, items: Sequence[Item], noisy: Row, shape: tuple[int, ...], config_hash: str
) -> dict[str, Any]:
    """What was measured."""
    facts: dict[str, Any] = {
        "dataset": settings.name,
        "config_hash": config_hash,
        "split": settings.split,
        "pairs": len(items),
        "frames": len({item.group for item in items}),
        "scenes": sorted({item.scene for item in items}),
        "locations": sorted({item.location for item in items}),
        "image": f"{shape[0]}x{shape[1]}",
        "identical_pairs": int((noisy.values["psnr"] >= metrics.PSNR_CAP_DB).sum()),
        "shadow_threshold": settings.shadow_threshold,
        "seed": settings.seed,
        "bootstrap": settings.bootstrap,
    }
    facts["rules"] = rules(facts)
    return facts


def _robustness(entry: Mapping[str, Any]) -> str:
    how = ", ".join(f"{key} = {value}" for key, value in entry["differs"].items()) or "nothing"
    lines: list[list[str]] = []
    for label, row in entry["rows"].items():
        if row["lost"]:
            lines.append([label, f"lost: {row['lost']}", "", "", ""])
            continue
        gain = row["gain"]
        shown = "" if label == "noisy" else f"{gain['mean']:+.2f} ({tables.interval(gain, 2)})"
        ssim, gmsd = (f"{row[name]['mean']:.3f}" for name in ("ssim", "gmsd"))
        lines.append([label, f"{row['psnr']['mean']:.2f}", shown, ssim, gmsd])
    head = ["method", "PSNR, dB", "against noisy, dB", "SSIM", "GMSD"]
    title = f"**{entry['dataset']}** ({entry['pairs']} pairs; differs in {how})"
    return f"{title}\n\n{markdown.table(head, lines)}"


def _arrow() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise FactoryError('the report needs pyarrow: pip install "simnfnd[report]"') from error
    return pyarrow, parquet
