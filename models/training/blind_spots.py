"""Hidden pixels, and the scale on which speckle is additive."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional


def log_scale(grey: Tensor, gain: float) -> Tensor:
    """Grey values in 0..1 -> log(1 + gain * grey), also 0..1; gain 0: as they are."""
    if not gain:
        return grey
    # Linear below black: a network may predict slightly negative values.
    compressed = torch.log1p(gain * grey.clamp_min(0)) + gain * grey.clamp_max(0)
    return compressed / math.log1p(gain)


def mask_blind_spots(
    noisy: Tensor, rng: np.random.Generator, share: float, radius: int
) -> tuple[Tensor, Tensor]:
    """The images with the surroundings of some pixels hidden, and which pixels (1, else 0).

    Everything within `radius` of a chosen pixel is replaced by pixels of the image drawn from
    between that and four more pixels away, so nothing of its own grain is left.
    """
    count, _, height, width = noisy.shape
    # Fewer where surroundings are wide: they would hide the whole image.
    chosen = rng.random((count, 1, height, width)) < min(share, 0.25 / (2 * radius + 1) ** 2)
    chosen[:, :, height // 2, width // 2] |= ~chosen.any(axis=(1, 2, 3))[:, None]
    mask = torch.from_numpy(chosen.astype(np.float32)).to(noisy.device)
    near = functional.max_pool2d(mask, 2 * radius + 1, stride=1, padding=radius) > 0
    length = rng.integers(radius + 1, radius + 5, size=(2, *chosen.shape))
    step = length * rng.choice([-1, 1], size=length.shape)
    rows = _reflected(np.arange(height)[:, None] + step[0], height)
    columns = _reflected(np.arange(width)[None, :] + step[1], width)
    index = torch.from_numpy(rows * width + columns).to(noisy.device)
    elsewhere = noisy.flatten(2).gather(2, index.flatten(2)).view_as(noisy)
    return torch.where(near, elsewhere, noisy), mask


def _reflected(index: np.ndarray, size: int) -> np.ndarray:
    """Indices mirrored at the borders."""
    index = np.abs(index)
    return np.clip(np.where(index >= size, 2 * (size - 1) - index, index), 0, size - 1)
