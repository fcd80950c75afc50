"""Means along whole beams and arcs, as features of every cell on them."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from .blocks import zeroed
from .polar_grid import extent


class LineContext(nn.Module):
    """Adds to features what their beams and arcs have in common, beside neighbouring ones.

    channels: of the features.  width: channels that are pooled.  It starts as the identity.
    """

    def __init__(self, channels: int, width: int = 12) -> None:
        super().__init__()
        self.pooled = nn.Conv2d(channels, width, 1)
        self.beams, self.arcs = (
            nn.Sequential(
                nn.Conv1d(width, 2 * width, 9, padding=4),
                nn.ReLU(),
                nn.Conv1d(2 * width, width, 9, padding=4),
            )
            for _ in range(2)
        )
        self.added = zeroed(nn.Conv2d(2 * width, channels, 1))

    def forward(self, x: Tensor, lines: Lines) -> Tensor:
        """(N, C, h, w) -> the same shape."""
        pooled = self.pooled(x)
        beams = self.beams(lines.means(pooled, 2))
        return lines.add(x, beams, self.arcs(lines.means(pooled, 3)), self.added)


class GridLines:
    """Columns are beams and rows are arcs: of a polar image, or of unknown geometry."""

    def means(self, x: Tensor, along: int) -> Tensor:
        """(N, C, h, w) -> (N, C, beams) for along=2, (N, C, arcs) for 3: means along each."""
        return x.float().mean(along)

    def add(self, x: Tensor, beams: Tensor, arcs: Tensor, added: nn.Conv2d) -> Tensor:
        """The features and `added` of what the beam and the arc of each cell have.

        x: (N, C, h, w).  beams: (N, D, beams).  arcs: (N, D, arcs).  added: 1x1, of 2 D channels;
        each line is convolved once, and not each of its cells.
        """
        weight = added.weight[..., 0]
        depth = beams.shape[1]
        along = functional.conv1d(beams, weight[:, :depth], added.bias)
        across = functional.conv1d(arcs, weight[:, depth:])
        return x + along[:, :, None, :] + across[:, :, :, None]


@dataclass(frozen=True, eq=False)
class MapLines:
    """The beams and arcs of a fan, for features of `shape` (h, w).

    beam, arc: (N, h * w) int64 numbers below w and h.  weight: (N, 1, h * w), 0 outside the sector.
    """

    beam: Tensor
    arc: Tensor
    weight: Tensor
    shape: tuple[int, int]

    @classmethod
    def of(cls, azimuth_rad: Tensor, range_fraction: Tensor, sector: Tensor) -> MapLines:
        """Derive them from maps of the image, (N, 1, H, W) each, for features of half its size.

        The sector's bearings and ranges are divided evenly into w beams and h arcs.
        """
        shape = sector.shape[-2] // 2, sector.shape[-1] // 2
        planes = functional.interpolate(torch.cat([azimuth_rad, range_fraction, sector], 1), shape)
        bearing, radius, inside = (planes[:, n].flatten(1) for n in range(3))

        def numbered(values: Tensor, count: int) -> Tensor:
            least, most = extent(values, inside > 0)
            return ((values - least) / (most - least) * count).clamp(0, count - 1).long()

        beam = numbered(bearing, shape[1])
        arc = numbered(radius, shape[0])
        return cls(beam, arc, (inside > 0).to(planes.dtype)[:, None], shape)

    def means(self, x: Tensor, along: int) -> Tensor:
        """See `GridLines`."""
        numbers, count = (self.beam, self.shape[1]) if along == 2 else (self.arc, self.shape[0])
        flat = x.float().flatten(2)
        channels = x.shape[1]
        weight = self.weight.float()
        index = numbers[:, None]
        zeros = torch.zeros(x.shape[0], channels, count, device=x.device)
        total = zeros.scatter_add(2, index.expand(-1, channels, -1), flat * weight)
        cells = zeros[:, :1].scatter_add(2, index, weight)
        return total / cells.clamp_min(1)

    def add(self, x: Tensor, beams: Tensor, arcs: Tensor, added: nn.Conv2d) -> Tensor:
        """See `GridLines`."""
        spread = [self._spread(beams, self.beam), self._spread(arcs, self.arc)]
        total: Tensor = x + added(torch.cat(spread, dim=1))
        return total

    def _spread(self, along: Tensor, numbers: Tensor) -> Tensor:
        """(N, C, beams or arcs) -> (N, C, h, w): every cell gets what its line has."""
        index = numbers[:, None].expand(-1, along.shape[1], -1)
        return along.gather(2, index).reshape(*along.shape[:2], *self.shape)


Lines = GridLines | MapLines
"""The beams and arcs of the cells of a feature map."""
