"""What is no echo stays: the page, axes and text of a figure, lines drawn over a fan."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from ...factory.sonar.geometry import FanGeometry
from ..recordings.fan.drawn import filled, without_lines
from ..recordings.fan.finder import find_geometry
from ..recordings.fan.page import Part, parts_of_figure

Gray = npt.NDArray[np.float32]
Denoise = Callable[..., Gray]
"""See `simnfnd.models.denoise.files`."""

_COVERED = 0.5  # of a part by a fan: then it is that fan


def denoise_figure(
    grey: Gray,
    denoise: Denoise,
    geometry: FanGeometry | None,
    looks: Sequence[Gray],
    parts: Sequence[Part] | None,
    *,
    drawn: bool = True,
) -> Gray:
    """`denoise` of a picture, (H, W) in 0..1; of a figure, of each picture in it by itself.

    A plot of lines, and an empty page, stay as they are.

    geometry: of the largest of them, where it is known; then others are looked at, too.
    parts: see `parts_of_page`.  drawn: whether lines may be drawn over a fan.
    """
    if geometry is not None or parts is None:
        result = _called(denoise, grey, geometry, looks, drawn)
    else:
        result = grey.copy()
    for part in parts or ():
        own = part.of(grey)
        place = None if geometry is None else find_geometry(own)
        denoised = _called(denoise, own, place, [part.of(look) for look in looks], drawn)
        result[part.rows, part.columns][part.inside] = denoised[part.inside]
    return result


def parts_of_page(page: Gray, geometry: FanGeometry | None) -> tuple[Part, ...] | None:
    """The pictures of a figure, without the one whose fan is known; None for what is no figure.

    page: (H, W) in 0..1, a grey picture, or the mean of all colours.
    """
    if geometry is not None and geometry.layout == "polar":
        return None
    parts = parts_of_figure(np.rint(page * 255).astype(np.uint8), dark=geometry is None)
    if geometry is None or not parts:
        return parts
    inside = geometry.sector_mask(*page.shape)
    return tuple(one for one in parts if one.of(inside).mean() < _COVERED * one.inside.mean())


def _called(
    denoise: Denoise,
    grey: Gray,
    geometry: FanGeometry | None,
    looks: Sequence[Gray],
    drawn: bool,
) -> Gray:
    """`denoise` of a picture without the lines that are drawn over its fan, which stay."""
    lines = without_lines(grey, geometry) if drawn else None
    if lines is None:
        return denoise(grey, geometry, looks=looks) if looks else denoise(grey, geometry)
    shown, where = lines
    seen = [filled(look, where) for look in looks]
    return np.where(where, grey, _called(denoise, shown, geometry, seen, drawn=False))
