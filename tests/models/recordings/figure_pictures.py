"""Figures as Matplotlib draws them: pictures with axes, titles and a colour bar."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

Bytes = npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class Drawn:
    """A figure, (H, W, 3) red first.

    boxes: rows and columns within each of its axes, colour bars left out.
    """

    picture: Bytes
    boxes: tuple[tuple[slice, slice], ...]
    axes: tuple[Axes, ...]

    @property
    def grey(self) -> Bytes:
        """(H, W) of a figure without colours."""
        return np.ascontiguousarray(self.picture[..., 0])


def figure(
    draw: Sequence[Callable[[Axes], Any]],
    columns: int = 1,
    *,
    look: str = "default",
    bar: bool = False,
    polar: bool = False,
    dpi: int = 100,
) -> Drawn:
    """One picture of a figure for each of `draw`, which takes axes."""
    with style.context(look):
        made = Figure(figsize=(6, 6), dpi=dpi)
        canvas = FigureCanvasAgg(made)
        options: Any = {"projection": "polar"} if polar else {}
        axes = [
            made.add_subplot(-(-len(draw) // columns), columns, number + 1, **options)
            for number in range(len(draw))
        ]
        for number, (one, put) in enumerate(zip(axes, draw, strict=True)):
            one.grid(False)
            shown = put(one)
            one.set_title(f"ping {number}")
            if bar:
                made.colorbar(shown)
        canvas.draw()
    picture = np.asarray(canvas.buffer_rgba())[..., :3].copy()
    boxes = []
    for one in axes:
        box = one.get_window_extent()
        rows = slice(round(len(picture) - box.y1), round(len(picture) - box.y0))
        boxes.append((rows, slice(round(box.x0), round(box.x1))))
    return Drawn(picture, tuple(boxes), tuple(axes))


def shown(values: npt.NDArray[Any], colours: str = "gray") -> Callable[[Axes], Any]:
    """Ranges by beams as a rectangle."""
    return lambda axes: axes.imshow(values, cmap=colours, aspect="auto", vmin=0, vmax=255)


def sector(
    values: npt.NDArray[Any], half_rad: float, near: float, colours: str = "gray"
) -> Callable[[Axes], Any]:
    """Ranges by beams as a fan, the sonar at (0, 0), the largest range 1."""
    ranges = np.linspace(near, 1, len(values) + 1)[:, None]
    bearings = np.linspace(-half_rad, half_rad, values.shape[1] + 1)

    def draw(axes: Axes) -> Any:
        if axes.name == "polar":
            axes.set_theta_zero_location("N")  # type: ignore[attr-defined]
            axes.set_thetalim(-1, 1)  # type: ignore[attr-defined]
            axes.set_rlim(0, 1)  # type: ignore[attr-defined]
            return axes.pcolormesh(bearings, ranges[:, 0], values, cmap=colours)
        axes.set_aspect("equal")
        across, along = ranges * np.sin(bearings), ranges * np.cos(bearings)
        return axes.pcolormesh(across, along, values, cmap=colours)

    return draw
