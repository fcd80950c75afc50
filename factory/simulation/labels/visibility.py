"""The column `visibility`: by how much the echoes of each object stand out."""

from __future__ import annotations

import json

import numpy as np
import numpy.typing as npt

from ...common.array_types import Array, Bools, Float32s, UInt16s
from ...dataset.schema import Column
from ..sonar import transfer
from ..sonar.settings import TransferSettings

_MOST_BYTES = 4096
VISIBILITY = (
    Column(
        "visibility",
        f"S{_MOST_BYTES}",
        "",
        "JSON object: number in /instance -> visibility, dB: mean level of the pixels of an object "
        "in the mean of noisy images, over the median level around its box; most visible first",
    ),
)
_AROUND = 0.5
"""Width of the frame around a box, as a part of its sides."""
_LEAST_AROUND_PX = 4


def visibility_row(
    mean: Array,
    instance: UInt16s,
    inside: Bools,
    settings: TransferSettings,
    quantity: transfer.Quantity,
) -> dict[str, float | str]:
    """The value of `VISIBILITY` for an image.

    mean: (H, W) uint8, or float32 in 0..1: the expected image; its noise floor hides what is
        fainter.
    inside: (H, W) bool, the sector.  settings, quantity: of the display.
    The least visible objects are left out where the text would exceed the column.
    """
    full_scale = 255 if mean.dtype == np.uint8 else 1
    grey = mean.astype(np.float32) / np.float32(full_scale)
    level_db = transfer.level_db(grey, settings, quantity)
    numbers, flat = np.unique(instance, return_inverse=True)
    pixels_by_number = np.split(
        np.argsort(flat, axis=None, kind="stable"), np.cumsum(np.bincount(flat.ravel()))[:-1]
    )
    is_around = inside & (instance == 0)
    visibility_db = {
        int(number): _contrast_db(level_db, is_around, pixels)
        for number, pixels in zip(numbers, pixels_by_number, strict=True)
        if number > 0
    }
    ordered = sorted(visibility_db.items(), key=lambda item: -item[1])
    while len(text := json.dumps(dict(ordered), separators=(",", ":"))) > _MOST_BYTES:
        ordered.pop()
    return {"visibility": text}


def _contrast_db(
    level_db: Float32s,
    is_around: Bools,
    pixels: npt.NDArray[np.intp],
) -> float:
    """Mean level of flat pixels over the median of what lies around their box; 0 beside nothing."""
    height, width = level_db.shape
    rows, columns = np.divmod(pixels, width)
    top, bottom = int(rows.min()), int(rows.max()) + 1
    left, right = int(columns.min()), int(columns.max()) + 1
    above = max(round(_AROUND * (bottom - top)), _LEAST_AROUND_PX)
    aside = max(round(_AROUND * (right - left)), _LEAST_AROUND_PX)
    window = (
        slice(max(top - above, 0), min(bottom + above, height)),
        slice(max(left - aside, 0), min(right + aside, width)),
    )
    around = level_db[window][is_around[window]]
    if not len(around):
        return 0.0
    return round(float(level_db.reshape(-1)[pixels].mean() - np.median(around)), 2)
