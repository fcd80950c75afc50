"""The comparison of real and simulated pictures as charts of the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from markupsafe import Markup

from ..report.charts import INK, in_page, page_colour, style
from .compare import Comparison
from .measure import Measured

_HISTOGRAMS = (("amplitude", "grey value"), ("gradient", "gradient, 1/128 a cell"))
_SPECTRA = (("radial", "radial"), ("along", "along range"), ("across", "along bearing"))
_SCALARS = (
    ("enl", "ENL"),
    ("si", "scintillation index"),
    ("acf_range", "grain along range, cells"),
    ("acf_bearing", "grain along bearing, cells"),
    ("spoke", "spoke index"),
    ("arc", "arc index"),
    ("slope", "range slope, dB/window"),
    ("highlight", "highlight contrast, dB"),
    ("shadow", "shadow contrast, dB"),
)


def ratios(comparisons: Sequence[Comparison]) -> Markup:
    """Distance over baseline of every statistic, logarithmic."""
    from matplotlib.figure import Figure  # a Figure needs no display

    names = list(comparisons[0].distance)
    figure = Figure(figsize=(8.5, 0.9 + 0.32 * len(comparisons)), layout="constrained")
    axis = figure.subplots()
    heights = np.arange(len(comparisons))[::-1].astype(np.float64)
    axis.axvspan(1e-3, 2, color=INK, alpha=0.12, lw=0)
    axis.axvline(1, color=INK, lw=1)
    for number, name in enumerate(names):
        shift = (number - (len(names) - 1) / 2) * -0.22
        rows = [(c.distance[name], max(c.baseline.mean, 1e-9)) for c in comparisons]
        middle, low, high = (
            np.maximum([getattr(d, key) / base for d, base in rows], 0.05)
            for key in ("mean", "low", "high")
        )
        colour = page_colour(number + 1)
        axis.hlines(heights + shift, low, high, color=colour, lw=2, alpha=0.6)
        axis.plot(middle, heights + shift, "o", color=colour, ms=5)
    axis.set(xscale="log", xlabel="distance to real over that of two halves of real (shaded: to 2)")
    axis.set_yticks(heights, [c.statistic.label + _unit(c.statistic.unit) for c in comparisons])
    axis.set_xlim(0.3, max(3.0, axis.get_xlim()[1]))
    axis.set_ylim(-0.7, len(comparisons) - 0.3)
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    style(axis)
    legend = {name: number + 1 for number, name in enumerate(names)}
    return in_page(figure, "distance over baseline", legend)


def distributions(measured: Mapping[str, Measured]) -> Markup:
    """Histograms, spectra and cumulative distributions of the numbers; "real" comes first."""
    from matplotlib.figure import Figure

    # Panels of one kind: to let matplotlib find their places takes longer than to draw them.
    figure = Figure(figsize=(12, 11.5))
    figure.subplots_adjust(0.06, 0.05, 0.99, 0.97, wspace=0.36, hspace=0.42)
    axes = figure.subplots(4, 4).ravel()
    panels = len(_HISTOGRAMS) + 1 + len(_SPECTRA) + len(_SCALARS)
    for axis in axes[panels:]:
        axis.set_axis_off()
    for number, (name, one) in enumerate(measured.items()):
        line = {"color": page_colour(number), "lw": 2.2 if name == "real" else 1.4}
        panel = iter(axes)
        for key, label in _HISTOGRAMS:
            axis = next(panel)
            axis.plot(getattr(one, key).mean(axis=0), **line)
            axis.set(title=label, yscale="log", ylim=(1e-5, None), ylabel="share")
        axis = next(panel)
        axis.plot(one.pattern.mean(axis=0), marker="o", ms=3, **line)
        axis.set(title="local binary pattern", ylabel="share")
        for key, label in _SPECTRA:
            axis = next(panel)
            spectrum = getattr(one, key).mean(axis=0)
            axis.plot((np.arange(len(spectrum)) + 0.5) / (2 * len(spectrum)), spectrum, **line)
            axis.set(title=f"spectrum, {label}", xlabel="cycles a cell", ylabel="dB of total")
        for key, label in _SCALARS:
            axis = next(panel)
            values = np.sort(one.scalar(key)[np.isfinite(one.scalar(key))])
            if values.size:
                axis.step(values, (np.arange(values.size) + 1) / values.size, where="post", **line)
            axis.set(title=label, ylabel="part of the pictures below", ylim=(0, 1.02))
    for axis in axes[:panels]:
        style(axis)
    legend = {name: number for number, name in enumerate(measured)}
    return in_page(figure, "what lies behind the distances", legend)


def _unit(unit: str) -> str:
    return f" [{unit}]" if unit and unit != "over chance" else ""
