"""The polar grid of a fan image: where its cells lie in the image, and the way back."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional


class FanSampling(NamedTuple):
    """Where the cells of a polar grid lie in fan images, and the pixels of these in the grid.

    to_polar, to_fan: (N, H, W, 2) positions for `sampled`.
    range_fraction, azimuth_rad: (N, 1, H, W) of the cells, near range first.
    The grid has as many cells as the image has pixels, from the least to the largest range and
    bearing of the sector (of the whole image where it shows none of the sector).
    """

    to_polar: Tensor
    to_fan: Tensor
    range_fraction: Tensor
    azimuth_rad: Tensor


def polar_grid(
    range_fraction: Tensor, azimuth_rad: Tensor, sector: Tensor, fan: bool | None = None
) -> FanSampling | None:
    """The grid for fan images whose pixels have these maps, each (N, 1, H, W), H and W 2 or more.

    fan: whether they are fans; None: seen from the maps.
    None for images that are polar already, or too small to tell.
    """
    if fan is None:
        columns = range_fraction[..., :1] if min(range_fraction.shape[-2:]) > 1 else range_fraction
        fan = not bool((range_fraction == columns).all())
    if not fan:
        return None
    height, width = range_fraction.shape[-2:]
    radius = range_fraction[:, 0]
    azimuth = azimuth_rad[:, 0]
    # In a fan, right and ahead of the sonar are linear in column and row (see `sonar.fan`).
    right = radius * torch.sin(azimuth)
    ahead = radius * torch.cos(azimuth)
    first_right, last_right, first_ahead, last_ahead = (
        edge.mean(1)[:, None, None]
        for edge in (right[:, :, 0], right[:, :, -1], ahead[:, 0, :], ahead[:, -1, :])
    )
    right_step = (last_right - first_right) / (width - 1)
    ahead_step = (last_ahead - first_ahead) / (height - 1)
    inside = sector[:, 0] > 0
    near, far = extent(radius, inside)
    left, right_end = extent(azimuth, inside)
    down = (torch.arange(height, device=radius.device) + 0.5) / height
    across = (torch.arange(width, device=radius.device) + 0.5) / width
    cell_range = (near + (far - near) * down[None, :, None]).expand_as(radius)
    cell_azimuth = (left + (right_end - left) * across[None, None, :]).expand_as(radius)
    column = (cell_range * torch.sin(cell_azimuth) - first_right) / right_step
    row = (cell_range * torch.cos(cell_azimuth) - first_ahead) / ahead_step
    to_polar = torch.stack([(2 * column + 1) / width - 1, (2 * row + 1) / height - 1], dim=-1)
    across_grid = 2 * (azimuth - left) / (right_end - left) - 1
    down_grid = 2 * (radius - near) / (far - near) - 1
    to_fan = torch.stack([across_grid, down_grid], dim=-1)
    return FanSampling(to_polar, to_fan, cell_range[:, None], cell_azimuth[:, None])


def extent(values: Tensor, inside: Tensor) -> tuple[Tensor, Tensor]:
    """Least and largest of each (N, ...) where `inside`, or of all of it; never equal."""
    dims = tuple(range(1, values.ndim))
    inside = inside | ~inside.flatten(1).any(1).view(-1, *[1] * len(dims))
    least = values.masked_fill(~inside, torch.inf).amin(dim=dims, keepdim=True)
    largest = values.masked_fill(~inside, -torch.inf).amax(dim=dims, keepdim=True)
    return least, largest.clamp_min(least + 1e-6)


def sampled(images: Tensor, at: Tensor) -> Tensor:
    """(N, C, H, W) at positions (N, h, w, 2) as of `grid_sample`, bilinear; edges are repeated."""
    # In 32 bits: halves of a pixel would be lost in 16 at the far side of a large image.
    with torch.autocast(images.device.type, enabled=False):
        return functional.grid_sample(
            images.float(), at, padding_mode="border", align_corners=False
        )
