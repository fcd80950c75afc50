"""Line plots as SVG by matplotlib, the same bytes for the same values."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SIDE_INCHES = 4.2
_COLOURS = (
    "#16202b", "#0b5fa5", "#b3261e", "#1b7f4b", "#8e5bb5", "#c77700", "#0f8a8a", "#8a6d3b",
    "#d1478c", "#5b6b7a", "#4d4fc4", "#7a9a01",
)  # fmt: skip
_DASHES = ("-", "--", ":")


@dataclass(frozen=True)
class Curve:
    """Points of one curve, in the order in which a line joins them."""

    x: Sequence[float]
    y: Sequence[float]


@dataclass(frozen=True)
class Plot:
    """One plot.

    curves: by label.  ticks: of the x axis; empty: where matplotlib puts them.
    is_logarithmic: whether the x axis is.  y_limits: lowest and highest y shown; None: of the data.
    marker: of the points, as matplotlib names it; empty for none.
    """

    title: str
    x_label: str
    y_label: str
    curves: Mapping[str, Curve]
    ticks: Sequence[float] = ()
    is_logarithmic: bool = False
    y_limits: tuple[float, float] | None = None
    marker: str = ""


def draw_plots(plots: Sequence[Plot]) -> bytes:
    """An SVG of plots side by side, with one legend below.

    The plots have curves of the same labels in the same order.
    Raises ImportError without matplotlib.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    labels = list(plots[0].curves)
    legend_columns = min(len(labels), 2 * len(plots))
    legend_inches = 0.3 + 0.2 * -(-len(labels) // legend_columns)
    figure = Figure((_SIDE_INCHES * len(plots), _SIDE_INCHES + legend_inches), layout="constrained")
    # Names of elements are random otherwise; text stays text, so that it can be searched.
    with rc_context({"svg.hashsalt": "simnfnd", "svg.fonttype": "none"}):
        for axes, plot in zip(figure.subplots(1, len(plots), squeeze=False)[0], plots, strict=True):
            _draw(axes, plot)
        figure.legend(
            *figure.axes[0].get_legend_handles_labels(),
            loc="outside lower left", ncols=legend_columns, frameon=False, fontsize="small",
        )  # fmt: skip
        content = io.BytesIO()
        figure.savefig(content, format="svg", metadata={"Date": None})
    return content.getvalue()


def _draw(axes: Axes, plot: Plot) -> None:
    """Draw one plot."""
    for number, (label, curve) in enumerate(plot.curves.items()):
        axes.plot(
            curve.x,
            curve.y,
            label=label,
            color=_COLOURS[number % len(_COLOURS)],
            linestyle=_DASHES[number // len(_COLOURS) % len(_DASHES)],
            marker=plot.marker,
        )
    axes.set_title(plot.title, loc="left", fontsize="medium")
    axes.set_xlabel(plot.x_label)
    axes.set_ylabel(plot.y_label)
    axes.grid(color="#e3e7ec")
    if plot.is_logarithmic:
        axes.set_xscale("log")
    if plot.ticks:
        axes.set_xticks(plot.ticks, [f"{tick:g}" for tick in plot.ticks], minor=False)
        axes.minorticks_off()
    if plot.y_limits:
        axes.set_ylim(*plot.y_limits)
