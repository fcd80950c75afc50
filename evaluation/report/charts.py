"""Charts, by matplotlib: SVG inside the page, PNG beside it."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from .content import shown_rows
from .sections import curve_of
from .tables import METRIC_NAMES, written

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Content = Mapping[str, Any]

_COLOURS = 10
"""Of the style sheet: --c0 .. --c9."""
# matplotlib knows no variables of a style sheet: these stand for them until the text is made.
INK, _GRID = "#000001", "#000002"
_FIRST_SERIES = 16
_ROWS = 40


@dataclass(frozen=True)
class Point:
    """A mean with its interval; label: said beside the figure when one points at it."""

    x: float
    y: float
    low: float | None = None
    high: float | None = None
    label: str = ""


@dataclass(frozen=True)
class Series:
    """Points of one method, in the order of x.  colour: number in the style sheet."""

    name: str
    points: tuple[Point, ...]
    colour: int


def chart(
    series: Sequence[Series],
    *,
    x_label: str,
    y_label: str,
    title: str,
    lines: bool,
    log_x: bool = False,
) -> Markup:
    """The SVG of some series in the colours of the page, with a legend below.

    lines: join the points of a series.  title: what a screen reader says.
    """
    if not any(one.points for one in series):
        return Markup("")
    from matplotlib.figure import Figure

    tips: list[str] = []
    figure = Figure(figsize=(7.1, 3.4), layout="constrained")
    axis = figure.subplots()
    for one in series:
        colour = page_colour(one.colour)
        if lines and len(one.points) > 1:
            axis.plot([p.x for p in one.points], [p.y for p in one.points], color=colour, lw=2)
        for point in one.points:
            if point.low is not None and point.high is not None:
                axis.vlines(point.x, point.low, point.high, color=colour, lw=2, alpha=0.55)
            (dot,) = axis.plot(point.x, point.y, "o", color=colour, ms=6.5)
            dot.set_gid(f"tip-{len(tips)}")
            said = f" {point.label}" if point.label else ""
            tips.append(f"{one.name}: {point.y:.2f}{said}")
    axis.set(xlabel=x_label, ylabel=y_label, xscale="log" if log_x else "linear")
    if log_x:
        axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    style(axis)
    return in_page(figure, title, {one.name: one.colour for one in series}, tips)


def cost(content: Content) -> Markup:
    """PSNR against time, and of networks against multiply-accumulates."""
    rows = {row["label"]: row for row in content["rows"]}
    labels = shown_rows(content["rows"], 9)
    timed, counted = [], []
    for colour, label in enumerate(labels):
        row = rows[label]
        psnr = row["metrics"]["psnr"]
        known = {"y": psnr["mean"], "low": psnr["low"], "high": psnr["high"]}
        if row["kind"] != "noisy" and row["milliseconds"]:
            said = f"dB, {row['milliseconds']:.1f} ms"
            said += f", {row['gmac']:.2f} GMAC" if row["gmac"] else ""
            point = Point(row["milliseconds"], **known, label=said)
            timed.append(Series(label, (point,), colour))
        if row["gmac"]:
            counted.append(Series(label, (Point(row["gmac"], **known, label="dB"),), colour))
    drawn = Markup("")
    for series, of, x_label in (
        (timed, "PSNR", "CPU milliseconds an image"),
        (counted, "PSNR of the networks", "GMAC for 256x256 pixels"),
    ):
        if len(series) > 1:  # one point shows no trade
            title = f"{of} against {x_label}"
            drawn += chart(
                series, x_label=x_label, y_label="PSNR, dB", title=title, lines=False, log_x=True
            )
    return drawn


def gain(entry: Content) -> Markup:
    """The gain against the middle of the bins of a factor; empty where it is no number."""
    centres = [one["centre"] for one in entry["bins"]]
    if sum(centre is not None for centre in centres) < 2:
        return Markup("")
    series = []
    for colour, (label, values) in enumerate(entry["rows"].items()):
        gains = [one["gain"] for one in values]
        points = tuple(
            Point(centre, one["mean"], one["low"], one["high"])
            for centre, one in zip(centres, gains, strict=True)
            if centre is not None and one is not None and one["mean"] is not None
        )
        if points:
            series.append(Series(label, points, colour))
    x_label = entry["factor"] + (f", {entry['unit']}" if entry["unit"] else "")
    title = f"gain in PSNR against {entry['factor']}"
    return chart(series, x_label=x_label, y_label="gain over noisy, dB", title=title, lines=True)


def robustness(content: Content) -> Markup:
    """PSNR on the further datasets; empty where they do not differ in one number."""
    entries = content["robustness"]
    curve = curve_of(entries, content["config"])
    if curve is None:
        return Markup("")
    key, values = curve
    labels = [label for label in entries[0]["rows"] if not entries[0]["rows"][label]["lost"]]
    rows = {row["label"]: row for row in content["rows"]}
    series = []
    for colour, label in enumerate(labels):
        own = [(float(content["config"][key]), rows[label]["metrics"]["psnr"])]
        there = [(v, e["rows"][label].get("psnr")) for v, e in zip(values, entries, strict=True)]
        points = [
            Point(value, one["mean"], one["low"], one["high"])
            for value, one in [*own, *there]
            if one is not None
        ]
        series.append(Series(label, tuple(sorted(points, key=lambda p: p.x)), colour))
    return chart(series, x_label=key, y_label="PSNR, dB", title=f"PSNR against {key}", lines=True)


def leaderboard(content: Content) -> bytes:
    """PNG: PSNR with intervals, SSIM, GMSD and time of the best form of each method."""
    from matplotlib.figure import Figure  # a second to import; a Figure needs no display

    rows = {row["label"]: row for row in content["rows"]}
    labels = [*shown_rows(content["rows"], _ROWS)[1:], "noisy"]
    labels.sort(key=lambda label: rows[label]["metrics"]["psnr"]["mean"])
    figure = Figure(
        figsize=(9.6, 1.3 + 0.36 * len(labels)), layout="constrained", facecolor="white"
    )
    axis, side = figure.subplots(1, 2, width_ratios=[2.2, 1])
    colours = {"noisy": "#8a929b", "baseline": "#4c78a8"}
    for height, label in enumerate(labels):
        row = rows[label]
        psnr, colour = row["metrics"]["psnr"], colours.get(row["kind"], "#d1600a")
        axis.plot([psnr["low"], psnr["high"]], [height, height], color=colour, lw=3, alpha=0.45)
        axis.plot(psnr["mean"], height, "o", color=colour, ms=7)
        cells = [
            written(row["metrics"][name]["mean"], METRIC_NAMES[name].digits)
            for name in ("psnr", "ssim", "gmsd")
        ]
        cells.append("" if row["kind"] == "noisy" else written(row["milliseconds"], 1))
        for column, text in enumerate(cells):
            side.text(column + 0.8, height, text, ha="right", va="center", fontsize=9)
    axis.set_ylim(-0.6, len(labels) - 0.1)
    axis.set_yticks(range(len(labels)), labels, fontsize=9)
    axis.set_xlabel("PSNR in dB against clean, with 95 % interval over frames")
    axis.grid(axis="x", color="#d5dbe2", lw=0.8)
    axis.spines[["top", "right", "left"]].set_visible(False)
    axis.tick_params(axis="y", length=0)
    for column, text in enumerate(("PSNR", "SSIM", "GMSD", "ms")):
        side.text(column + 0.8, len(labels) - 0.45, text, ha="right", fontsize=9, weight="bold")
    side.set(xlim=(0, 4), ylim=axis.get_ylim())
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


def page_colour(number: int) -> str:
    """Stands for a colour of the style sheet until `in_page`."""
    return f"#0000{_FIRST_SERIES + number % _COLOURS:02x}"


def style(axis: Any) -> None:
    """Axes in the colours of the page."""
    axis.grid(color=_GRID, lw=0.8)
    axis.set_axisbelow(True)
    axis.spines[["top", "right", "left"]].set_visible(False)
    axis.spines["bottom"].set_color(INK)
    axis.tick_params(which="both", colors=INK, length=0, labelsize=9)
    for label in (axis.xaxis.label, axis.yaxis.label, axis.title):
        label.set(color=INK, fontsize=10)


def in_page(
    figure: Figure, title: str, legend: Mapping[str, int], tips: Sequence[str] = ()
) -> Markup:
    """A figure as SVG with the page's colours and font, and a legend below.

    legend: name -> number of its colour.  tips: what the artists of gid tip-0, tip-1, ... say when
    one points at them.
    """
    import matplotlib

    buffer = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": title}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None})
    svg = buffer.getvalue()
    text = svg[svg.index("<svg") :]
    text = re.sub(r' width="[^"]*pt"| height="[^"]*pt"', "", text, count=2)
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = text.replace("<svg", f'<svg role="img" aria-label="{escape(title, quote=True)}"', 1)
    for number, tip in enumerate(tips):
        named = f"<g><title>{escape(tip)}</title>"
        text = text.replace(f'<g id="tip-{number}">', named, 1)
    for number in range(_COLOURS):
        text = text.replace(page_colour(number), f"var(--c{number})")
    text = text.replace(INK, "var(--soft)").replace(_GRID, "var(--line)")
    # Namespaces and fonts are those of the page.
    text = re.sub(r' xmlns(:\w+)?="[^"]*"', "", text).replace("xlink:href", "href")
    text = re.sub(r"font: ([\d.]+px) [^;\"]*", r"font-size: \1", text)
    names = "".join(
        f'<li class="s{number % _COLOURS}"><span aria-hidden="true"></span>{escape(name)}</li>'
        for name, number in legend.items()
    )
    return Markup(
        f'<figure class="chart"><div class="scroll">{text}</div>'
        f'<ul class="legend">{names}</ul></figure>'
    )
