"""Crops that weights are fitted on, drawn from stretches, single frames and simulated pictures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ...factory.sonar.geometry import FanGeometry
from ..data.pairs import Batch, Image

PATCH = 192
"""Crops have as many pixels as a square of this side, where pictures are large enough."""

_TRIES = 6
_LEAST_KNOWN = 0.25  # of a crop's pixels


def crop_size(height: int, width: int, patch: int = PATCH) -> tuple[int, int]:
    """Rows and columns of a crop: of narrow pictures longer than wide, for as many pixels."""
    rows, columns = min(height, patch), min(width, patch)
    if columns < patch:
        rows = min(height, patch * patch // columns)
    if rows < patch:
        columns = min(width, patch * patch // rows)
    return rows, columns


def crop(
    noisy: Image,
    target: Image,
    geometry: FanGeometry | None,
    size: tuple[int, int],
    extras: Sequence[str],
    rng: np.random.Generator,
) -> Batch:
    """A batch of one of `size`, mirrored left to right or not; maps where geometry is known.

    noisy, target: (H, W) float32 in 0..1.  target: NaN where it is unknown; the crop is drawn
    again while more than three quarters of it are.
    """
    rows, columns = size
    for _ in range(_TRIES):
        top = int(rng.integers(noisy.shape[0] - rows + 1))
        left = int(rng.integers(noisy.shape[1] - columns + 1))
        window = np.s_[top : top + rows, left : left + columns]
        if np.isfinite(target[window]).mean() >= _LEAST_KNOWN:
            break
    step = -1 if rng.random() < 0.5 else 1
    images = {"noisy": noisy[window], "clean": target[window]}
    if geometry is not None:
        maps = geometry.maps(top, left, rows, columns)
        if step < 0:
            maps["azimuth_rad"] = -maps["azimuth_rad"]
        images |= {name: maps[name] for name in extras if name in maps}
    return {
        name: torch.from_numpy(np.ascontiguousarray(image[:, ::step]))[None, None]
        for name, image in images.items()
    }
