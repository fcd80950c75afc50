"""The figure of `inspect --png`: how noisy the pairs are, and what was drawn for them."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ...files import write_atomically
from . import palette
from .summary import DatasetSummary

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDE, _DPI = 4, 120


def draw(found: DatasetSummary, path: Path) -> Path:
    """Write a PNG of histograms: PSNR, SSIM, then every column whose values vary."""
    # A second to import, and only needed here.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = [("PSNR, dB", found.psnr_db, palette.AMBER), ("SSIM", found.ssim, palette.AMBER)]
    panels += [(title, values, palette.BLUE) for title, values in _varying(found)]
    tall = -(-len(panels) // _WIDE)
    figure = Figure(figsize=(3.1 * _WIDE, 1.9 * tall + 0.6), facecolor=palette.BACKGROUND)
    FigureCanvasAgg(figure)
    counts = ", ".join(f"{count} {split}" for split, count in found.source.splits.items())
    figure.suptitle(
        f"{counts} pairs   config {found.source.config_hash[:8]}",
        x=0.01, ha="left", color=palette.TEXT, fontsize=12, weight="bold",
    )  # fmt: skip
    grid = figure.subplots(tall, _WIDE, squeeze=False).ravel()
    for axes, panel in zip(grid, panels, strict=False):
        _draw_panel(axes, *panel)
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    figure.tight_layout(pad=0.7, rect=(0, 0, 1, 0.985))
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
    write_atomically(path, buffer.getvalue())
    return path


def _varying(found: DatasetSummary) -> list[tuple[str, npt.NDArray[np.float64]]]:
    panels = []
    for column in found.source.columns:
        if np.dtype(column.dtype).kind == "S":
            continue
        values = found.numbers(column.name)
        if values.size and np.ptp(values) > 0:
            units = "" if column.units in ("", "1") else f", {column.units}"
            panels.append((f"{column.name}{units}", values))
    return panels


def _draw_panel(axes: Axes, title: str, values: npt.NDArray[np.float64], colour: str) -> None:
    from matplotlib.ticker import MaxNLocator

    values = values[np.isfinite(values)]
    axes.set_facecolor(palette.PANEL)
    axes.set_title(title, color=palette.TEXT, fontsize=8, loc="left", pad=3)
    if values.size:
        bins = min(30, max(5, round(2 * values.size ** (1 / 3))))
        axes.hist(values, bins=bins, color=colour, rwidth=0.92)
        axes.axvline(float(values.mean()), color=palette.TEXT, linewidth=0.8, linestyle=":")
    axes.tick_params(colors=palette.FAINT, labelsize=6.5, length=2)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(4, integer=True))
    for spine in axes.spines.values():
        spine.set_color(palette.LINE)
