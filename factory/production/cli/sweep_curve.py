"""The curve of a sweep: how noisy images are against the values of a parameter."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ...common.plots import Curve, Plot, draw_plots

_FIGURE = "psnr_db"


def draw_curve(names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> bytes:
    """An SVG of `sweep_plot`; b"" where there is nothing to draw.  Raises ImportError."""
    plot = sweep_plot(names, rows)
    return draw_plots([plot]) if plot else b""


def sweep_plot(names: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> Plot | None:
    """PSNR of noisy against clean over the parameter with most values, a line for each other point.

    names: the swept keys.  rows: of the table, with their values as words.
    None where no key has two numbers, or no dataset was made.
    """
    measured = [row for row in rows if isinstance(row.get(_FIGURE), int | float)]
    axis = _axis(names, measured)
    if not axis:
        return None
    curves = _curves(axis, [name for name in names if name != axis], measured)
    if all(len(curve.x) < 2 for curve in curves.values()):
        return None
    ticks = sorted({value for curve in curves.values() for value in curve.x})
    return Plot(
        title="Noisy against clean",
        x_label=axis,
        y_label="PSNR, dB",
        curves=curves,
        ticks=ticks,
        marker="o",
    )


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


def _curves(
    axis: str, others: Sequence[str], rows: Sequence[Mapping[str, Any]]
) -> dict[str, Curve]:
    """A curve for each combination of the other keys, by its label."""
    points_by_label: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        label = ", ".join(f"{name.rpartition('.')[2]}={row.get(name, '')}" for name in others)
        point = (float(row[axis]), float(row[_FIGURE]))
        points_by_label.setdefault(label or "all points", []).append(point)
    return {
        label: Curve(*zip(*sorted(points), strict=True))
        for label, points in points_by_label.items()
    }
