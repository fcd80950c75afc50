"""Curves of rows as an SVG drawing, without a plotting library."""

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
_SIDE = 320
_LEFT = 56
_TOP = 28
_BOTTOM = 48
_LEGEND = 20
"""Pixels: side of the plot, margins, height of a line of the legend."""


@dataclass(frozen=True)
class Plot:
    """One plot.

    x: what all curves are taken at.  curves: label -> values in 0..1.  logarithmic: the x axis.
    ticks: of the x axis.
    """

    title: str
    x_label: str
    y_label: str
    x: Sequence[float]
    curves: Mapping[str, Sequence[float]]
    ticks: Sequence[float]
    logarithmic: bool = False


def drawn(plots: Sequence[Plot]) -> str:
    """Plots side by side with one legend below, all of the same rows in the same order."""
    labels = list(plots[0].curves)
    panel = _LEFT + _SIDE + 24
    legend_top = _TOP + _SIDE + _BOTTOM
    per_column = math.ceil(len(labels) / len(plots))
    width = panel * len(plots)
    height = legend_top + _LEGEND * per_column + 8
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="12" role="img">',
        f'<rect width="{width}" height="{height}" fill="#ffffff"/>',
    ]
    for number, plot in enumerate(plots):
        parts.append(f'<g transform="translate({number * panel + _LEFT},{_TOP})">')
        parts += _panel(plot)
        parts.append("</g>")
    for number, label in enumerate(labels):
        x = _LEFT + panel * (number // per_column)
        y = legend_top + _LEGEND * (number % per_column)
        parts.append(f'<path d="M{x} {y}h26" fill="none" {_stroke(number)}/>')
        parts.append(f'<text x="{x + 34}" y="{y + 4}" fill="#16202b">{escape(label)}</text>')
    return "\n".join([*parts, "</svg>", ""])


def _panel(plot: Plot) -> list[str]:
    parts = [f'<text x="0" y="-10" font-weight="bold">{escape(plot.title)}</text>']
    for tick in plot.ticks:
        x = _x(plot, tick)
        parts.append(f'<path d="M{x:.1f} 0V{_SIDE}" stroke="#e3e7ec"/>')
        parts.append(f'<text x="{x:.1f}" y="{_SIDE + 16}" text-anchor="middle">{tick:g}</text>')
    for tick in (0, 0.2, 0.4, 0.6, 0.8, 1):
        y = _SIDE * (1 - tick)
        parts.append(f'<path d="M0 {y:.1f}H{_SIDE}" stroke="#e3e7ec"/>')
        parts.append(f'<text x="-8" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>')
    middle = _SIDE / 2
    parts.append(
        f'<text x="{middle}" y="{_SIDE + 34}" text-anchor="middle">{escape(plot.x_label)}</text>'
    )
    parts.append(
        f'<text transform="translate(-38,{middle}) rotate(-90)" text-anchor="middle">'
        f"{escape(plot.y_label)}</text>"
    )
    for number, values in enumerate(plot.curves.values()):
        points = " ".join(
            f"{_x(plot, x):.1f},{_SIDE * (1 - value):.1f}"
            for x, value in zip(plot.x, values, strict=True)
        )
        parts.append(f'<polyline points="{points}" fill="none" {_stroke(number)}/>')
    return parts


def _x(plot: Plot, value: float) -> float:
    """Pixels from the left edge of a plot."""
    low, high = plot.x[0], plot.x[-1]
    if plot.logarithmic:
        return _SIDE * math.log(value / low) / math.log(high / low)
    return _SIDE * (value - low) / (high - low)


def _stroke(number: int) -> str:
    colour = _COLOURS[number % len(_COLOURS)]
    dash = _DASHES[number // len(_COLOURS) % len(_DASHES)]
    return f'stroke="{colour}" stroke-width="1.8" stroke-dasharray="{dash}"'
