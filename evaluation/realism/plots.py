"""The comparison in pictures, once for light and once for dark pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from .compare import Comparison
from .measure import Measured
from .polar import Gray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Values = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Theme:
    """Colours of one kind of page.  series: of the simulations, in their order."""

    paper: str
    ink: str
    muted: str
    series: tuple[str, ...]


THEMES = {
    "light": Theme("#ffffff", "#1a1a1a", "#767676", ("#1f6fc4", "#d1600a", "#0f8a5f", "#9a4fb5")),
    "dark": Theme("#16181c", "#ececec", "#9a9a9a", ("#6cb0ff", "#ff9d52", "#4fd0a0", "#d59be8")),
}
PLOTS = ("ratios", "distributions", "pictures")
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


def draw_all(
    out: Path,
    comparisons: Sequence[Comparison],
    measured: Mapping[str, Measured],
    pictures: Mapping[str, Sequence[Gray]],
) -> list[str]:
    """Write NAME.png and NAME-dark.png of every plot into `out`; returns the names.

    measured, pictures: "real" first, then the simulations.
    """
    for mode, theme in THEMES.items():
        figures = (
            _ratios(comparisons, theme),
            _distributions(measured, theme),
            _pictures(pictures, theme),
        )
        for name, figure in zip(PLOTS, figures, strict=True):
            figure.savefig(out / f"{name}{'-dark' if mode == 'dark' else ''}.png", dpi=110)
    return list(PLOTS)


def _figure(
    width: float, height: float, theme: Theme, layout: Literal["constrained"] | None = "constrained"
) -> Figure:
    # pyplot takes a second to import and is not needed; Figure needs no display.
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout=layout, facecolor=theme.paper)


def _style(axis: Axes, theme: Theme) -> None:
    axis.set_facecolor(theme.paper)
    axis.tick_params(colors=theme.muted, labelcolor=theme.ink, labelsize=8)
    axis.spines[["top", "right"]].set_visible(False)
    for spine in axis.spines.values():
        spine.set_color(theme.muted)
    axis.xaxis.label.set_color(theme.ink)
    axis.yaxis.label.set_color(theme.ink)
    axis.title.set_color(theme.ink)


def _legend(axis: Axes, theme: Theme, **options: Any) -> None:
    axis.legend(frameon=False, fontsize=8, labelcolor=theme.ink, **options)


def _ratios(comparisons: Sequence[Comparison], theme: Theme) -> Figure:
    """Distance over baseline of every statistic, logarithmic."""
    names = list(comparisons[0].distance)
    figure = _figure(8.5, 0.9 + 0.32 * len(comparisons), theme)
    axis = figure.add_subplot()
    heights = np.arange(len(comparisons))[::-1].astype(np.float64)
    axis.axvspan(1e-3, 2, color=theme.muted, alpha=0.15, lw=0)
    axis.axvline(1, color=theme.ink, lw=1)
    for number, name in enumerate(names):
        shift = (number - (len(names) - 1) / 2) * -0.22
        colour = theme.series[number % len(theme.series)]
        rows = [(c.distance[name], max(c.baseline.mean, 1e-9)) for c in comparisons]
        middle, low, high = (
            np.maximum([getattr(d, key) / base for d, base in rows], 0.05)
            for key in ("mean", "low", "high")
        )
        axis.hlines(heights + shift, low, high, color=colour, lw=2, alpha=0.6)
        axis.plot(middle, heights + shift, "o", color=colour, ms=5, label=name)
    axis.set(xscale="log", xlabel="distance to real over that of two halves of real (shaded: to 2)")
    axis.set_yticks(heights, [c.statistic.label + _unit(c.statistic.unit) for c in comparisons])
    left, right = 0.3, max(3.0, axis.get_xlim()[1])
    axis.set_xlim(left, right)
    axis.set_ylim(-0.7, len(comparisons) - 0.3)
    axis.xaxis.set_major_formatter(lambda value, _: f"{value:g}")
    _style(axis, theme)
    _legend(axis, theme, loc="upper center", bbox_to_anchor=(0.5, 1.06), ncols=len(names))
    return figure


def _unit(unit: str) -> str:
    return f" [{unit}]" if unit and unit != "over chance" else ""


def _distributions(measured: Mapping[str, Measured], theme: Theme) -> Figure:
    """Histograms, spectra and cumulative distributions of the numbers, real and simulated."""
    # Panels of one kind: to let matplotlib find their places takes longer than to draw them.
    figure = _figure(12, 11.5, theme, layout=None)
    figure.subplots_adjust(0.06, 0.05, 0.99, 0.97, wspace=0.36, hspace=0.42)
    axes = figure.subplots(4, 4).ravel()
    panels = len(_HISTOGRAMS) + 1 + len(_SPECTRA) + len(_SCALARS)
    for axis in axes[panels:]:
        axis.set_axis_off()
    colours = [theme.ink, *(theme.series[i % len(theme.series)] for i in range(len(measured)))]
    for (name, one), colour in zip(measured.items(), colours, strict=False):
        wide = {"color": colour, "lw": 2.2 if name == "real" else 1.4, "label": name}
        panel = iter(axes)
        for key, label in _HISTOGRAMS:
            axis = next(panel)
            axis.plot(getattr(one, key).mean(axis=0), **wide)
            axis.set(title=label, yscale="log", ylim=(1e-5, None), ylabel="share")
        axis = next(panel)
        axis.plot(one.pattern.mean(axis=0), marker="o", ms=3, **wide)
        axis.set(title="local binary pattern", ylabel="share")
        for key, label in _SPECTRA:
            axis = next(panel)
            spectrum = getattr(one, key).mean(axis=0)
            axis.plot((np.arange(len(spectrum)) + 0.5) / (2 * len(spectrum)), spectrum, **wide)
            axis.set(title=f"spectrum, {label}", xlabel="cycles a cell", ylabel="dB of total")
        for key, label in _SCALARS:
            axis = next(panel)
            values = np.sort(one.scalar(key)[np.isfinite(one.scalar(key))])
            if values.size:
                axis.step(values, (np.arange(values.size) + 1) / values.size, where="post", **wide)
            axis.set(title=label, ylabel="part of the pictures below", ylim=(0, 1.02))
    for axis in axes[:panels]:
        axis.title.set_fontsize(9)
        axis.xaxis.label.set_fontsize(8)
        axis.yaxis.label.set_fontsize(8)
        _style(axis, theme)
    _legend(axes[0], theme)
    return figure


def _pictures(pictures: Mapping[str, Sequence[Gray]], theme: Theme) -> Figure:
    """A row of polar pictures of each set, far range on top."""
    columns = max(len(row) for row in pictures.values())
    figure = _figure(1.35 * columns, 3.6 * len(pictures), theme)
    axes = figure.subplots(len(pictures), columns, squeeze=False)
    for row, (name, images) in zip(axes, pictures.items(), strict=True):
        for axis in row:
            axis.set_axis_off()
        for axis, image in zip(row, images, strict=False):
            axis.imshow(image[::-1], cmap="gray", vmin=0, vmax=1, aspect="auto")
        row[0].set_title(name, fontsize=10, loc="left", color=theme.ink)
    return figure
