"""Fan pictures resampled to the sonar's own grid, range by bearing, and back, inside a network.

In a fan picture range and bearing lie differently at every pixel; on the polar grid the blur along
range is vertical everywhere and echoes of one ping lie side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

_SMALLEST = 1e-6


@dataclass(frozen=True, eq=False)
class PolarGrid:
    """Where the cells of a polar grid lie in fan pictures, and the pixels of these in the grid.

    to_polar, to_fan: (N, H, W, 2) sampling positions as torch's `grid_sample` has them.
    range_fraction, azimuth_rad: (N, 1, H, W) of the cells, near range first.
    The grid has as many cells as the picture has pixels, from the least to the largest range and
    bearing of the sector (of the whole picture where it shows none of the sector).
    """

    to_polar: Tensor
    to_fan: Tensor
    range_fraction: Tensor
    azimuth_rad: Tensor

    def polar(self, images: Tensor) -> Tensor:
        """(N, C, H, W) fan pictures on the polar grid, bilinear."""
        return _sampled(images, self.to_polar)

    def fan(self, images: Tensor) -> Tensor:
        """(N, C, H, W) of the polar grid as fan pictures, bilinear; repeated outside the grid."""
        return _sampled(images, self.to_fan)


def polar_grid(
    range_fraction: Tensor, azimuth_rad: Tensor, sector: Tensor, fan: bool | None = None
) -> PolarGrid | None:
    """The grid for fan pictures whose pixels have these maps, each (N, 1, H, W), H and W 2 or more.

    fan: whether they are fans; None: seen from the maps.
    None for pictures that are polar already, or too small to tell.
    """
    if fan is None:
        fan = _is_fan(range_fraction)
    if not fan:
        return None
    height, width = range_fraction.shape[-2:]
    radius, azimuth = range_fraction[:, 0], azimuth_rad[:, 0]
    # In a fan, right and ahead of the sonar are linear in column and row (see `sonar.fan`).
    right, ahead = radius * torch.sin(azimuth), radius * torch.cos(azimuth)
    first_right, first_ahead = right[:, :, 0].mean(1), ahead[:, 0, :].mean(1)
    right_step = (right[:, :, -1].mean(1) - first_right) / (width - 1)
    ahead_step = (ahead[:, -1, :].mean(1) - first_ahead) / (height - 1)

    inside = sector[:, 0] > 0
    inside = inside | ~inside.any(dim=2, keepdim=True).any(dim=1, keepdim=True)
    near, far = _extent(radius, inside)
    left, right_end = _extent(azimuth, inside)
    down = (torch.arange(height, device=radius.device) + 0.5) / height
    across = (torch.arange(width, device=radius.device) + 0.5) / width
    cell_range = (near + (far - near) * down[None, :, None]).expand_as(radius)
    cell_azimuth = (left + (right_end - left) * across[None, None, :]).expand_as(radius)
    column = (cell_range * torch.sin(cell_azimuth) - _each(first_right)) / _each(right_step)
    row = (cell_range * torch.cos(cell_azimuth) - _each(first_ahead)) / _each(ahead_step)
    to_polar = torch.stack([(2 * column + 1) / width - 1, (2 * row + 1) / height - 1], dim=-1)
    to_fan = torch.stack(
        [
            2 * (azimuth - left) / (right_end - left) - 1,
            2 * (radius - near) / (far - near) - 1,
        ],
        dim=-1,
    )
    return PolarGrid(to_polar, to_fan, cell_range[:, None], cell_azimuth[:, None])


def _is_fan(range_fraction: Tensor) -> bool:
    """Whether ranges differ along rows; False for pictures too small to tell."""
    height, width = range_fraction.shape[-2:]
    if min(height, width) < 2:
        return False
    return not bool((range_fraction == range_fraction[..., :1]).all())


def _extent(values: Tensor, inside: Tensor) -> tuple[Tensor, Tensor]:
    """Least and largest of (N, H, W) values where `inside`, each (N, 1, 1), never equal."""
    least = values.masked_fill(~inside, torch.inf).amin(dim=(1, 2), keepdim=True)
    largest = values.masked_fill(~inside, -torch.inf).amax(dim=(1, 2), keepdim=True)
    return least, largest.clamp_min(least + _SMALLEST)


def _each(values: Tensor) -> Tensor:
    return values[:, None, None]


def _sampled(images: Tensor, grid: Tensor) -> Tensor:
    # In 32 bits: halves of a pixel would be lost in 16 at the far side of a large picture.
    with torch.autocast(images.device.type, enabled=False):
        return functional.grid_sample(
            images.float(), grid, padding_mode="border", align_corners=False
        )
