"""Charts, by matplotlib: SVG inside a page, PNG beside it."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from .content import shown_rows
from .tables import METRIC_NAMES, written

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Content = Mapping[str, Any]

_ROWS = 40


def cost(content: Content) -> Markup:
    """PSNR against time of the best form of each method; empty where one point shows no trade."""
    from matplotlib.figure import Figure  # a second to import; a Figure needs no display

    rows = {row["label"]: row for row in content["rows"]}
    timed = [rows[one] for one in shown_rows(content["rows"], 9)[1:] if rows[one]["milliseconds"]]
    if len(timed) < 2:
        return Markup("")
    figure = Figure(figsize=(7.1, 3.4), layout="constrained")
    axis = figure.subplots()
    for row in timed:
        psnr, gmac = row["metrics"]["psnr"], row["gmac"]
        label = f"{row['label']} ({gmac:.2f} GMAC)" if gmac else row["label"]
        axis.errorbar(row["milliseconds"], psnr["mean"], yerr=_sides(psnr), fmt="o", label=label)
    axis.set(xlabel="CPU milliseconds an image", ylabel="PSNR, dB", xscale="log")
    figure.legend(loc="outside right upper", fontsize=8)
    return as_svg(figure, "PSNR against CPU milliseconds an image")


def leaderboard(content: Content) -> bytes:
    """PNG: PSNR with intervals, SSIM, GMSD and time of the best form of each method."""
    from matplotlib.figure import Figure

    rows = {row["label"]: row for row in content["rows"]}
    labels = [*shown_rows(content["rows"], _ROWS)[1:], "noisy"]
    labels.sort(key=lambda label: rows[label]["metrics"]["psnr"]["mean"])
    figure = Figure(figsize=(9.6, 1.3 + 0.36 * len(labels)), layout="constrained")
    axis, side = figure.subplots(1, 2, width_ratios=[2.2, 1], sharey=True)
    colours = {"noisy": "#8a929b", "baseline": "#4c78a8"}
    for height, label in enumerate(labels):
        row, psnr = rows[label], rows[label]["metrics"]["psnr"]
        colour = colours.get(row["kind"], "#d1600a")
        axis.errorbar(psnr["mean"], height, xerr=_sides(psnr), fmt="o", color=colour)
        cells = {
            METRIC_NAMES[name].label: written(
                row["metrics"][name]["mean"], METRIC_NAMES[name].digits
            )
            for name in ("psnr", "ssim", "gmsd")
        }
        cells["ms"] = written(row["milliseconds"], 1)
        for column, text in enumerate(cells.values()):
            side.text(column + 0.8, height, text, ha="right", va="center", fontsize=9)
    for column, text in enumerate(cells):
        side.text(column + 0.8, len(labels) - 0.45, text, ha="right", fontsize=9, weight="bold")
    axis.set(ylim=(-0.6, len(labels)), xlabel="PSNR in dB, with 95 % interval over frames")
    axis.set_yticks(range(len(labels)), labels, fontsize=9)
    axis.grid(axis="x")
    side.set(xlim=(0, 4))
    side.set_axis_off()
    facts = content["facts"]
    figure.suptitle(
        f"{facts['dataset']}, {facts['split']} split: {facts['pairs']} pairs of "
        f"{facts['frames']} frames, {facts['image']}; best form of each method",
        fontsize=10,
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=150)
    return buffer.getvalue()


def as_svg(figure: Figure, title: str) -> Markup:
    """A figure as it stands in a page; title: what a screen reader says."""
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title}):
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    svg = buffer.getvalue()
    # Namespaces are those of the page.
    foreign = r'<metadata>.*?</metadata>| xmlns(:\w+)?="[^"]*"'
    text = re.sub(foreign, "", svg[svg.index("<svg") :], flags=re.DOTALL)
    text = text.replace("xlink:href", "href")
    name = escape(title, quote=True)
    return Markup(f'<figure class="chart" role="img" aria-label="{name}">'
        f'<div class="scroll">{text}</div></figure>')


def _sides(item: Content) -> list[list[float]]:
    """How far the ends of an interval are from its mean."""
    ends = [item["mean"] - item["low"], item["high"] - item["mean"]]
    return [[max(end, 0.0)] for end in ends]
