"""Line and scatter charts as inline SVG, coloured by the page's style sheet for light and dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from markupsafe import Markup

WIDTH, HEIGHT = 680, 320
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, 16, 14, 46
SERIES = 10
"""Colours of the style sheet, s0 .. s9."""


@dataclass(frozen=True)
class Point:
    """A mean with its interval; label: written beside it."""

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


@dataclass(frozen=True)
class _Scale:
    low: float
    high: float
    start: float
    end: float
    log: bool = False

    def __call__(self, value: float) -> float:
        low, high = self.low, self.high
        if self.log:
            low, high, value = math.log10(low), math.log10(high), math.log10(value)
        return self.start + (value - low) / (high - low) * (self.end - self.start)

    def ticks(self) -> list[float]:
        if self.log:
            first, last = math.floor(math.log10(self.low)), math.ceil(math.log10(self.high))
            decades = [10.0**n for n in range(first, last + 1)]
            between = [k * ten for ten in decades for k in (1, 2, 5)]
            ticks = [value for value in between if self.low <= value <= self.high]
            tens = [value for value in decades if self.low <= value <= self.high]
            return tens if len(tens) > 2 else ticks
        step = 10 ** math.floor(math.log10((self.high - self.low) / 4))
        step *= next(k for k in (1, 2, 5, 10) if (self.high - self.low) / (k * step) <= 6)
        first = math.ceil(self.low / step - 1e-9)
        return [n * step for n in range(first, math.floor(self.high / step + 1e-9) + 1)]


def chart(
    series: Sequence[Series],
    *,
    x_label: str,
    y_label: str,
    title: str,
    lines: bool,
    log_x: bool = False,
) -> Markup:
    """The SVG of some series, with a legend below; lines: join the points of a series.

    title: what a screen reader says.
    """
    points = [point for one in series for point in one.points]
    if not points:
        return Markup("")
    x = _scale([p.x for p in points], _LEFT + 14, WIDTH - _RIGHT - 14, log_x)
    ends = [v for p in points for v in (p.y, p.low, p.high) if v is not None]
    y = _scale(ends, HEIGHT - _BOTTOM, _TOP, False)
    parts = [
        f'<figure class="chart"><div class="scroll"><svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" '
        f'aria-label="{escape(title, quote=True)}">',
        *_axes(x, y, x_label, y_label),
        *(_drawn(one, x, y, lines) for one in series),
        "</svg></div>",
        _legend(series),
        "</figure>",
    ]
    return Markup("".join(parts))


def _drawn(one: Series, x: _Scale, y: _Scale, lines: bool) -> str:
    parts = [f'<g class="s{one.colour % SERIES}">']
    if lines and len(one.points) > 1:
        path = " ".join(f"{x(p.x):.1f},{y(p.y):.1f}" for p in one.points)
        parts.append(f'<polyline class="line" points="{path}"/>')
    for point in one.points:
        px, py = x(point.x), y(point.y)
        if point.low is not None and point.high is not None:
            parts.append(
                f'<line class="whisker" x1="{px:.1f}" x2="{px:.1f}" y1="{y(point.low):.1f}" '
                f'y2="{y(point.high):.1f}"/>'
            )
        title = f"{one.name}: {point.y:.2f}" + (f" {point.label}" if point.label else "")
        parts.append(
            f'<circle cx="{px:.1f}" cy="{py:.1f}" r="4"><title>{escape(title)}</title></circle>'
        )
    return "".join([*parts, "</g>"])


def _axes(x: _Scale, y: _Scale, x_label: str, y_label: str) -> list[str]:
    bottom, right = HEIGHT - _BOTTOM, WIDTH - _RIGHT
    parts = []
    for value in y.ticks():
        at = y(value)
        parts.append(f'<line class="grid" x1="{_LEFT}" x2="{right}" y1="{at:.1f}" y2="{at:.1f}"/>')
        parts.append(
            f'<text x="{_LEFT - 8}" y="{at + 4:.1f}" text-anchor="end">{_number(value)}</text>'
        )
    for value in x.ticks():
        parts.append(
            f'<text x="{x(value):.1f}" y="{bottom + 18}" text-anchor="middle">'
            f"{_number(value)}</text>"
        )
    parts.append(f'<line class="axis" x1="{_LEFT}" x2="{right}" y1="{bottom}" y2="{bottom}"/>')
    middle = (_LEFT + right) / 2
    parts.append(
        f'<text class="label" x="{middle}" y="{HEIGHT - 6}" text-anchor="middle">'
        f"{escape(x_label)}</text>"
    )
    parts.append(
        f'<text class="label" transform="translate(14 {(bottom + _TOP) / 2}) rotate(-90)" '
        f'text-anchor="middle">{escape(y_label)}</text>'
    )
    return parts


def _legend(series: Sequence[Series]) -> str:
    names = "".join(
        f'<li class="s{one.colour % SERIES}"><span aria-hidden="true"></span>'
        f"{escape(one.name)}</li>"
        for one in series
    )
    return f'<ul class="legend">{names}</ul>'


def _scale(values: Sequence[float], start: float, end: float, log: bool) -> _Scale:
    low, high = min(values), max(values)
    if log:
        low = max(low, 1e-3)
        return _Scale(low / 1.3, max(high, low) * 1.3, start, end, log=True)
    room = 0.06 * (high - low) or 0.5 * abs(high) or 1.0
    return _Scale(low - room, high + room, start, end)


def _number(value: float) -> str:
    return f"{value:.4g}"
