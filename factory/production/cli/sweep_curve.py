"""The curve of a sweep as SVG: how noisy images are against the values of a parameter."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from html import escape
from typing import Any, NamedTuple

_WIDTH, _HEIGHT = 560, 360
_LEFT, _RIGHT, _TOP, _BOTTOM = 60, 180, 24, 50
_INNER_WIDTH = _WIDTH - _LEFT - _RIGHT
_INNER_HEIGHT = _HEIGHT - _TOP - _BOTTOM
_COLOURS = ("#0b63c5", "#c2540a", "#2a8a3e", "#8a3fb0", "#b02a4c", "#6b6b6b")
_FIGURE = "psnr_db"


class _Line(NamedTuple):
    """Points (value, PSNR in dB) in the order of the values, and what they have in common."""

    label: str
    points: list[tuple[float, float]]


def draw_curve(names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> str:
    """PSNR of noisy against clean over the parameter with most values, a line for each other point.

    names: the swept keys.  rows: of the table, with their values as words.
    "" where no key has two numbers, or no dataset was made.
    """
    measured = [row for row in rows if isinstance(row.get(_FIGURE), int | float)]
    axis = _axis(names, measured)
    if not axis:
        return ""
    lines = list(_lines(axis, [name for name in names if name != axis], measured))
    return _svg(axis, lines) if any(len(line.points) > 1 for line in lines) else ""


def _axis(names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> str:
    """The key with most different numbers; "" where none has two."""
    counts = {}
    for name in names:
        values = {_number(row.get(name)) for row in rows}
        if None not in values and len(values) > 1:
            counts[name] = len(values)
    return max(counts, key=counts.__getitem__, default="")


def _number(word: Any) -> float | None:
    try:
        value = float(word)
    except (TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None


def _lines(axis: str, others: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> Iterator[_Line]:
    grouped: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        label = ", ".join(f"{name.rpartition('.')[2]}={row.get(name, '')}" for name in others)
        grouped.setdefault(label, []).append((float(row[axis]), float(row[_FIGURE])))
    for label, points in grouped.items():
        yield _Line(label, sorted(points))


class _Scale(NamedTuple):
    """From values and figures to pixels of the drawing."""

    least_value: float
    most_value: float
    least_figure: float
    most_figure: float

    @classmethod
    def of(cls, lines: Sequence[_Line]) -> _Scale:
        """The one that all points fit into."""
        values = [value for line in lines for value, _ in line.points]
        figures = [figure for line in lines for _, figure in line.points]
        return cls(min(values), max(values), min(figures), max(figures))

    def x(self, value: float) -> float:
        """Pixels from the left."""
        share = (value - self.least_value) / (self.most_value - self.least_value)
        return _LEFT + _INNER_WIDTH * share

    def y(self, figure: float) -> float:
        """Pixels from the top."""
        span = self.most_figure - self.least_figure or 1.0
        return _TOP + _INNER_HEIGHT * (self.most_figure - figure) / span


def _svg(axis: str, lines: Sequence[_Line]) -> str:
    scale = _Scale.of(lines)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{_WIDTH}" height="{_HEIGHT}" '
        'font-family="sans-serif" font-size="12">',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>',
        *_axes(axis, scale, {value for line in lines for value, _ in line.points}),
    ]
    for number, line in enumerate(lines):
        parts += _curve(line, number, scale)
    return "\n".join([*parts, "</svg>", ""])


def _axes(axis: str, scale: _Scale, values: Collection[float]) -> Iterator[str]:
    middle = _LEFT + _INNER_WIDTH / 2
    yield (
        f'<rect x="{_LEFT}" y="{_TOP}" width="{_INNER_WIDTH}" height="{_INNER_HEIGHT}" '
        'fill="none" stroke="#999"/>'
    )
    yield _text(middle, _HEIGHT - 8, axis, "middle")
    yield _text(_LEFT, _TOP - 6, "PSNR, dB", "middle")
    for value in sorted(values):
        yield _text(scale.x(value), _HEIGHT - _BOTTOM + 18, f"{value:g}", "middle")
    for figure in (scale.least_figure, scale.most_figure):
        yield _text(_LEFT - 6, scale.y(figure) + 4, f"{figure:.2f}", "end")


def _curve(line: _Line, number: int, scale: _Scale) -> Iterator[str]:
    colour = _COLOURS[number % len(_COLOURS)]
    places = [(scale.x(value), scale.y(figure)) for value, figure in line.points]
    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    yield f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>'
    for x, y in places:
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{colour}"/>'
    yield _text(_WIDTH - _RIGHT + 10, _TOP + 14 + 16 * number, line.label, "start", colour)


def _text(x: float, y: float, text: str, anchor: str, colour: str = "black") -> str:
    place = f'x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}"'
    return f'<text {place} fill="{colour}">{escape(text)}</text>'
