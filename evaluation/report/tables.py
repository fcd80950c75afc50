"""The leaderboard and the paper's tables as Markdown, LaTeX and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

from ...factory.dataset.describe import markdown
from ..methods.method import shown
from .names import METRIC_NAMES, written, written_p
from .paper import TABLE_METRICS

Content = Mapping[str, Any]

_SHORT = ("ssim", "gmsd", "psnr_fan", "shadow_iou")
_MORE = ("ssim_fan", "gmsd_fan", "shadow_residual", "false_light_rate", "gmsd_unpooled", "ms_ssim",
         "edge_preservation", "enl", "cnr", "ratio_mean", "m_index")  # fmt: skip


def leaderboard(rows: Sequence[Content]) -> str:
    """Markdown: PSNR with its interval, the paired gain and its test, other metrics, the cost."""
    names = [name for name in _SHORT if _has(rows, name)]
    head = ["method", "PSNR, dB", "95 % interval", "against noisy, dB", "p (Holm)", "wins"]
    head += [METRIC_NAMES[name].label for name in names] + ["ms", "GMAC"]
    lines: list[list[str]] = []
    for row in rows:
        title = f"{row['label']}{shown(row['parameters'])}"
        title += " (several looks)" if row["looks"] else ""
        if row["lost"] is not None:
            lines.append([title, f"lost: {row['lost']}", *[""] * (len(head) - 2)])
            continue
        psnr, gain = row["metrics"]["psnr"], row["against_noisy"].get("psnr")
        cells = [title, written(psnr["mean"], 2), interval(psnr, 2)]
        if gain is None:
            cells += ["", "", ""]
        else:
            low, high = written(gain["low"], 2, True), written(gain["high"], 2, True)
            cells.append(f"{written(gain['mean'], 2, True)} ({low} .. {high})")
            cells += [written_p(gain["p_holm"]), percent(gain["wins"])]
        cells += [written(row["metrics"][n]["mean"], METRIC_NAMES[n].digits) for n in names]
        cells += [written(row["milliseconds"], 1), written(row["gmac"], 2) if row["gmac"] else ""]
        lines.append(cells)
    return markdown.table(head, lines)


def more_metrics(rows: Sequence[Content]) -> str:
    """Markdown: the means of the metrics that the leaderboard leaves out."""
    names = [name for name in _MORE if _has(rows, name)]
    lines = [
        [row["label"], *(written(row["metrics"][n]["mean"], METRIC_NAMES[n].digits) for n in names)]
        for row in rows
        if row["lost"] is None
    ]
    return markdown.table(["method", *(METRIC_NAMES[name].label for name in names)], lines)


def beside_paper(table: Sequence[Content]) -> str:
    """Markdown: PSNR, SSIM and GMSD of the paper and ours."""
    lines = [
        [
            line["title"],
            _three(line["paper"]),
            "-" if line["ours"] is None else _three(line["ours"]),
            line["row"] or "not given",
        ]
        for line in table
    ]
    head = ["row", "paper PSNR / SSIM / GMSD", "ours", "which row here"]
    return markdown.table(head, lines, "lrrl")


def breakdown(entry: Content) -> str:
    """Markdown: mean PSNR of the rows in each bin of a factor."""
    bins = entry["bins"]
    head = [entry["factor"], *(f"{one['label']} ({one['pairs']})" for one in bins)]
    lines = [
        [label, *(written(one["mean"], 2) for one in values)]
        for label, values in entry["rows"].items()
    ]
    return markdown.table(head, lines)


def latex(rows: Sequence[Content]) -> str:
    """A tabular of booktabs: PSNR with interval, SSIM, GMSD, wins; the best of each column bold."""
    alive = [row for row in rows if row["lost"] is None]
    best = {}
    for name in TABLE_METRICS:
        values = [row["metrics"][name]["mean"] for row in alive]
        best[name] = max(values) if METRIC_NAMES[name].better > 0 else min(values)
    lines = [
        r"\begin{tabular}{lrrrrr}",
        r"\toprule",
        r"Method & PSNR / dB & 95\,\% interval & SSIM & GMSD & Wins \\",
        r"\midrule",
    ]
    for row in alive:
        cells = [_escaped(row["label"])]
        for name in TABLE_METRICS:
            value = row["metrics"][name]["mean"]
            text = written(value, METRIC_NAMES[name].digits)
            cells.append(rf"\textbf{{{text}}}" if value == best[name] else text)
        psnr = row["metrics"]["psnr"]
        cells.insert(2, f"{written(psnr['low'], 2)}--{written(psnr['high'], 2)}")
        gain = row["against_noisy"].get("psnr")
        cells.append("" if gain is None else percent(gain["wins"]).replace("\u00a0%", r"\,\%"))
        lines.append(" & ".join(cells) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def as_csv(rows: Sequence[Content]) -> str:
    """A line a row: every mean, interval and paired difference."""
    names = [name for name in METRIC_NAMES if _has(rows, name)]
    parts = ("mean", "low", "high")
    head = ["method", "parameters", "gain", "offset", "milliseconds", "gmac", "lost"]
    for name in names:
        head += [name, f"{name}_low", f"{name}_high"]
        head += [f"{name}_gain{end}" for end in ("", "_low", "_high", "_p", "_p_holm", "_wins")]
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        levels = row["levels"] or {"gain": "", "offset": ""}
        cells: list[Any] = [row["label"], shown(row["parameters"]).strip(" ()")]
        cells += [levels["gain"], levels["offset"], row["milliseconds"], row["gmac"], row["lost"]]
        for name in names:
            mean, gain = row["metrics"].get(name, {}), row["against_noisy"].get(name, {})
            cells += [mean.get(part) for part in parts]
            cells += [gain.get(part) for part in (*parts, "p", "p_holm", "wins")]
        writer.writerow(cells)
    return text.getvalue()


def interval(item: Content, digits: int) -> str:
    """Low .. high."""
    return f"{written(item['low'], digits)} .. {written(item['high'], digits)}"


def percent(share: float | None) -> str:
    """A share in per cent."""
    return "-" if share is None else f"{100 * share:.0f}\u00a0%"


def _has(rows: Sequence[Content], name: str) -> bool:
    return any(row["metrics"].get(name, {}).get("count") for row in rows)


def _three(figures: Content) -> str:
    psnr, ssim, gmsd = (figures[name] for name in TABLE_METRICS)
    return f"{psnr:.2f} / {ssim:.3f} / {gmsd:.3f}"


def _escaped(text: str) -> str:
    return text.replace("_", r"\_").replace("%", r"\%").replace("&", r"\&")
