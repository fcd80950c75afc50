"""How the figures of the gallery look: panels in rows, one label each."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..dataset.describe import palette
from ..files import explain_os_errors, write_atomically
from ..frame import Frame
from ..render.base import Rendered
from ..sonar.echoes import Echoes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_ROW_INCHES, _LABEL_INCHES, _GAP_INCHES, _TITLE_INCHES = 2.35, 0.26, 0.07, 0.42
_WIDEST_INCHES = 12.0
_DPI = 110
# Few enough for a page of documentation, more than amber and sea need.
_PALETTE = 256
_ABOVE_CELLS = 420


@dataclass(frozen=True, eq=False)
class Panel:
    """One picture: (H, W) values with a colour map, or (H, W, 3) uint8 colours.

    extent: (left, right, bottom, top) in metres where the panel has axes.
    """

    name: str
    image: npt.NDArray[Any]
    colours: str = "echo"
    limits: tuple[float, float] = (0.0, 1.0)
    extent: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class Figure:
    """Rows of panels under one title; file is the PNG's name without suffix."""

    file: str
    title: str
    rows: Sequence[Sequence[Panel]]


def photo(name: str, rgb: npt.NDArray[np.uint8]) -> Panel:
    """(H, W, 3) uint8 colours as they are."""
    return Panel(name, rgb)


def depth(name: str, frame: Frame) -> Panel:
    """Depth along the optical axis, near is bright; black without a measurement."""
    depth_m = frame.depth_m
    near, far = np.percentile(depth_m[frame.valid], (0.5, 99.5))
    # Beyond the far end, so that the darkest tone is a measurement and not the lack of one.
    limits = (float(near), float(far + 0.15 * (far - near)))
    return Panel(name, np.where(frame.valid, depth_m, np.nan), "depth", limits)


def radiance(name: str, rendered: Rendered) -> Panel:
    """Rendered echo strength of each camera pixel, on a square-root scale."""
    value = np.sqrt(np.maximum(rendered.radiance, 0))
    return Panel(name, value, "gray", (0, float(np.percentile(value[value > 0], 99))))


def sonar(name: str, picture: npt.NDArray[np.generic]) -> Panel:
    """A sonar picture with values 0..1 or 0..255."""
    scale = 255.0 if picture.dtype == np.uint8 else 1.0
    return Panel(name, picture.astype(np.float32) / scale)


def from_above(name: str, echoes: Echoes) -> Panel:
    """Mean echo strength (after time-varying gain) of the cloud per cell of the floor plan."""
    ground_m = echoes.ground_range_m()
    right_m = ground_m * np.sin(echoes.azimuth_rad)
    ahead_m = ground_m * np.cos(echoes.azimuth_rad)
    half_m = float(np.abs(right_m).max())
    top_m, bottom_m = float(ahead_m.max()), float(ahead_m.min())
    cell_m = max(2 * half_m, top_m - bottom_m) / _ABOVE_CELLS
    columns, rows = (max(1, round(m / cell_m)) for m in (2 * half_m, top_m - bottom_m))
    # The outermost points lie on the border of the last cell.
    column = np.minimum((right_m + half_m) / cell_m, columns - 1).astype(np.intp)
    row = np.minimum((top_m - ahead_m) / cell_m, rows - 1).astype(np.intp)
    flat = row * columns + column
    total = np.bincount(flat, weights=echoes.strength, minlength=rows * columns)
    count = np.bincount(flat, minlength=rows * columns)
    mean = (total / np.maximum(count, 1)).reshape(rows, columns)
    limit = float(np.percentile(mean[mean > 0], 97))
    return Panel(name, mean, "echo", (0, limit), (-half_m, half_m, bottom_m, top_m))


def save(figure: Figure, folder: Path) -> Path:
    """Draw `figure` into `folder` and return the path."""
    # A second to import, and only needed here.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure as Canvas
    from PIL import Image

    row_inches = min(_ROW_INCHES, *(_row_height(row) for row in figure.rows))
    widths = [_row_width(row, row_inches) for row in figure.rows]
    size = (
        max(widths) + 2 * _GAP_INCHES,
        len(figure.rows) * (row_inches + _LABEL_INCHES) + _TITLE_INCHES + _GAP_INCHES,
    )
    canvas = Canvas(figsize=size, facecolor=palette.BACKGROUND)
    FigureCanvasAgg(canvas)
    canvas.text(
        _GAP_INCHES / size[0], 1 - 0.24 / size[1], figure.title,
        color=palette.TEXT, fontsize=11, weight="bold", va="center",
    )  # fmt: skip
    for number, row in enumerate(figure.rows):
        left = _GAP_INCHES
        bottom = size[1] - _TITLE_INCHES - (number + 1) * (row_inches + _LABEL_INCHES)
        for panel in row:
            width = row_inches * _aspect(panel)
            place = (left, bottom, width, row_inches)
            _draw(canvas.add_axes(_fraction(place, size)), panel)
            left += width + _GAP_INCHES
    buffer = io.BytesIO()
    canvas.savefig(buffer, format="png", dpi=_DPI)
    buffer.seek(0)
    full = Image.open(buffer).convert("RGB")
    colours = full.quantize(_PALETTE, Image.Quantize.MEDIANCUT, kmeans=1)
    small = full.quantize(_PALETTE, palette=colours, dither=Image.Dither.FLOYDSTEINBERG)
    content = io.BytesIO()
    small.save(content, format="png", optimize=True)
    path = folder / f"{figure.file}.png"
    with explain_os_errors(folder, "--out"):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content.getvalue())
    return path


def _aspect(panel: Panel) -> float:
    return panel.image.shape[1] / panel.image.shape[0]


def _row_width(row: Sequence[Panel], height: float) -> float:
    return sum(height * _aspect(panel) for panel in row) + _GAP_INCHES * (len(row) - 1)


def _row_height(row: Sequence[Panel]) -> float:
    """The height at which a row is as wide as a figure may be."""
    return (_WIDEST_INCHES - _GAP_INCHES * (len(row) - 1)) / sum(_aspect(panel) for panel in row)


def _fraction(
    place: tuple[float, float, float, float], size: tuple[float, float]
) -> tuple[float, float, float, float]:
    left, bottom, width, height = place
    return left / size[0], bottom / size[1], width / size[0], height / size[1]


def _draw(axes: Axes, panel: Panel) -> None:
    if panel.image.ndim == 3:
        axes.imshow(panel.image, aspect="auto")
    else:
        low, high = panel.limits
        axes.imshow(
            panel.image,
            cmap=_colour_map(panel.colours),
            vmin=low,
            vmax=high,
            extent=panel.extent,
            aspect="auto",
            interpolation="antialiased",
        )
    axes.set_title(panel.name, color=palette.FAINT, fontsize=8.5, loc="left", pad=3)
    axes.set_facecolor("black")
    if panel.extent is None:
        axes.set_xticks([])
        axes.set_yticks([])
    else:
        _metres(axes, panel.extent)
    for spine in axes.spines.values():
        spine.set(color=palette.LINE, linewidth=0.5)


def _metres(axes: Axes, extent: tuple[float, float, float, float]) -> None:
    """A bar of whole metres in the corner: ticks would need room that pictures can use."""
    left, right, bottom, top = extent
    length = max(1, round((right - left) / 6))
    x, y = left + 0.04 * (right - left), bottom + 0.06 * (top - bottom)
    axes.plot([x, x + length], [y, y], color=palette.TEXT, linewidth=1.5)
    axes.text(
        x + length / 2, y + 0.015 * (top - bottom), f"{length} m",
        color=palette.TEXT, fontsize=7.5, ha="center", va="bottom",
    )  # fmt: skip
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    axes.set_xticks([])
    axes.set_yticks([])


def _colour_map(name: str) -> Any:
    if name == "echo":
        return palette.colour_map(palette.ECHO)
    return {"gray": "gray", "depth": "viridis_r"}[name]
