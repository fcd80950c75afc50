"""What `--compare` shows: pictures before and after side by side, under their names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ..recordings.base import FULL_SCALE

CAPTION_PX = 20
"""Height of the line with the names."""

_NAMES = ("noisy", "denoised", "clean")
_GAP_PX = 4
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def sheet(rows: Sequence[Sequence[npt.NDArray[Any]]]) -> npt.NDArray[np.uint8]:
    """Noisy, denoised (and clean) side by side, one row a sample, named on top.

    rows: pictures (H, W) or (H, W, C) of one size; uint8, uint16 or float in 0..1.
    Returns (CAPTION_PX + rows * H, W', ...) uint8.
    """
    lines = [_side_by_side([_shown(image) for image in images]) for images in rows]
    first = _shown(rows[0][0])
    names = [_name(text, first) for text in _NAMES[: len(rows[0])]]
    return np.concatenate([_side_by_side(names), *lines], axis=0)


def _side_by_side(panels: Sequence[npt.NDArray[np.uint8]]) -> npt.NDArray[np.uint8]:
    gap = np.full((panels[0].shape[0], _GAP_PX, *panels[0].shape[2:]), 128, np.uint8)
    return np.concatenate([part for panel in panels for part in (gap, panel)][1:], axis=1)


def _name(text: str, like: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """The text, light on dark, as wide as a panel and no wider than fits."""
    width = like.shape[1]
    band = np.full((CAPTION_PX, width), 24, np.uint8)
    (long, _), _ = cv2.getTextSize(text, _FONT, 1.0, 1)
    size = min(0.45, (width - 6) / long)
    if size > 0:
        cv2.putText(band, text, (3, CAPTION_PX - 6), _FONT, size, (235,), 1, cv2.LINE_AA)
    if like.ndim == 2:
        return band
    name = np.full((CAPTION_PX, width, like.shape[2]), 255, np.uint8)  # an alpha stays opaque
    name[..., :3] = band[..., None]
    return name


def _shown(image: npt.NDArray[Any]) -> npt.NDArray[np.uint8]:
    full = 1.0 if image.dtype.kind == "f" else FULL_SCALE[str(image.dtype)]
    return np.asarray(np.rint(np.clip(image / full, 0, 1) * 255), dtype=np.uint8)
