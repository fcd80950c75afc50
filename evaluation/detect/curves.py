"""Curves of the rows as an SVG drawing, without a plotting library."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

_COLOURS = (
    "#16202b", "#0b5fa5", "#b3261e", "#1b7f4b", "#8e5bb5", "#c77700", "#0f8a8a", "#8a6d3b",
    "#d1478c", "#5b6b7a", "#4d4fc4", "#7a9a01",
)  # fmt: skip
_DASHES = ("", "6 3", "2 2")
_SIDE_PX = 320
_LEFT_PX = 56
_RIGHT_PX = 24
_TOP_PX = 28
_BOTTOM_PX = 48
_LEGEND_LINE_PX = 20
"""Side of a plot, its margins, and height of a line of the legend."""


@dataclass(frozen=True)
class Plot:
    """One plot.

    x: ascending values at which all curves are sampled.  curves: label -> values in 0..1.
    ticks: of the x axis.  logarithmic: whether the x axis is.
    """

    title: str
    x_label: str
    y_label: str
    x: Sequence[float]
    curves: Mapping[str, Sequence[float]]
    ticks: Sequence[float]
    logarithmic: bool = False


def draw_plots(plots: Sequence[Plot]) -> str:
    """An SVG of plots side by side, with one legend below.

    The plots have curves of the same labels in the same order.
    """
    labels = list(plots[0].curves)
    panel_width = _LEFT_PX + _SIDE_PX + _RIGHT_PX
    legend_top = _TOP_PX + _SIDE_PX + _BOTTOM_PX
    lines_per_column = math.ceil(len(labels) / len(plots))
    width = panel_width * len(plots)
    height = legend_top + _LEGEND_LINE_PX * lines_per_column + 8
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12" role="img">',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for number, plot in enumerate(plots):
        left = number * panel_width + _LEFT_PX
        parts.append(f'<g transform="translate({left},{_TOP_PX})">')
        parts += _draw_panel(plot)
        parts.append("</g>")
    for number, label in enumerate(labels):
        column, line = divmod(number, lines_per_column)
        x = _LEFT_PX + panel_width * column
        y = legend_top + _LEGEND_LINE_PX * line
        parts.append(f'<path d="M{x} {y}h26" fill="none" {_stroke(number)}/>')
        parts.append(f'<text x="{x + 34}" y="{y + 4}" fill="#16202b">{escape(label)}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _draw_panel(plot: Plot) -> list[str]:
    """Title, grid, axis labels and curves of one plot; its upper left corner is the origin."""
    parts = [f'<text x="0" y="-10" font-weight="bold">{escape(plot.title)}</text>']
    for tick in plot.ticks:
        x = _x_px(plot, tick)
        parts.append(f'<path d="M{x:.1f} 0V{_SIDE_PX}" stroke="#e3e7ec"/>')
        parts.append(f'<text x="{x:.1f}" y="{_SIDE_PX + 16}" text-anchor="middle">{tick:g}</text>')
    for tick in (0, 0.2, 0.4, 0.6, 0.8, 1):
        y = _SIDE_PX * (1 - tick)
        parts.append(f'<path d="M0 {y:.1f}H{_SIDE_PX}" stroke="#e3e7ec"/>')
        parts.append(f'<text x="-8" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    middle = _SIDE_PX / 2
    parts.append(
        f'<text x="{middle}" y="{_SIDE_PX + 34}" text-anchor="middle">{escape(plot.x_label)}</text>'
    )
    parts.append(
        f'<text transform="translate(-38,{middle}) rotate(-90)" text-anchor="middle">'
        f"{escape(plot.y_label)}</text>"
    )
    for number, values in enumerate(plot.curves.values()):
        points = " ".join(
            f"{_x_px(plot, x):.1f},{_SIDE_PX * (1 - value):.1f}"
            for x, value in zip(plot.x, values, strict=True)
        )
        parts.append(f'<polyline points="{points}" fill="none" {_stroke(number)}/>')
    return parts


def _x_px(plot: Plot, value: float) -> float:
    """Pixels from the left edge of a plot."""
    low = plot.x[0]
    high = plot.x[-1]
    if plot.logarithmic:
        return _SIDE_PX * math.log(value / low) / math.log(high / low)
    return _SIDE_PX * (value - low) / (high - low)


def _stroke(number: int) -> str:
    """Attributes of the line of a curve, by the number of its row."""
    colour = _COLOURS[number % len(_COLOURS)]
    dash = _DASHES[number // len(_COLOURS) % len(_DASHES)]
    return f'stroke="{colour}" stroke-width="1.8" stroke-dasharray="{dash}"'
