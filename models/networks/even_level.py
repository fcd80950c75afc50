"""The local level of an image, by which networks see every part of it equally bright.

Whoever multiplies part of an image, by a wrong time-varied gain, by glare or by a display, changes
neither the scene nor how its grain compares with its level.  A network that gets the image over its
local level, and whose change is multiplied by that level again, follows such a gain by
construction.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

CELL_PX = 8
"""Pixels along a side of the cells whose means the level is made of; images are padded to them."""
_SMOOTHINGS = 3  # means of 3 x 3 cells: nearly a Gaussian, standard deviation 12 pixels
_EVEN = 0.25  # grey value of every level that a network sees
_FLOOR = 0.01  # grey value below which levels fade into darkness, where steps of 8 bits are grain


def evening_gain(noisy: Tensor, sector: Tensor) -> Tensor:
    """What to multiply an image by so that its local level is everywhere about the same.

    noisy: (N, 1, H, W) in 0..1; H and W divide by `CELL_PX`.  sector: the same shape, 1 where
    insonified, else 0; only insonified pixels count.  Returns (N, 1, H, W), positive.
    """
    lit = _smoothed(noisy.float() * sector)
    area = _smoothed(sector.float())
    level = functional.interpolate(
        lit / area.clamp_min(1e-3), scale_factor=CELL_PX, mode="bilinear", align_corners=False
    )
    gain: Tensor = (_EVEN + _FLOOR) / (level.clamp_min(0) + _FLOOR)
    return gain.detach()


def _smoothed(plane: Tensor) -> Tensor:
    """(N, 1, H, W) -> (N, 1, H / CELL_PX, W / CELL_PX): local means; zeros around the image."""
    cells = functional.avg_pool2d(plane, CELL_PX)
    for _ in range(_SMOOTHINGS):
        cells = functional.avg_pool2d(cells, 3, stride=1, padding=1)
    return torch.as_tensor(cells)
