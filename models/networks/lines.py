"""Context along whole beams and arcs, for spokes, arcs and gains that no window can tell.

A spoke is one beam that is too loud at all ranges, an arc one range at all bearings.  A
convolution sees a part of them; the mean along the whole beam, beside those of its neighbours, says
at once which one it is.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

_NEIGHBOURS = 9


class LineContext(nn.Module):
    """Adds to features what their beams and arcs have in common, beside neighbouring ones.

    channels: of the features.  width: channels that are pooled.  It starts as the identity.
    """

    def __init__(self, channels: int, width: int = 12) -> None:
        super().__init__()
        self.pooled = nn.Conv2d(channels, width, 1)
        self.beams, self.arcs = (
            nn.Sequential(
                nn.Conv1d(width, 2 * width, _NEIGHBOURS, padding=_NEIGHBOURS // 2),
                nn.ReLU(),
                nn.Conv1d(2 * width, width, _NEIGHBOURS, padding=_NEIGHBOURS // 2),
            )
            for _ in range(2)
        )
        self.added = nn.Conv2d(2 * width, channels, 1)
        nn.init.zeros_(self.added.weight)
        assert self.added.bias is not None
        nn.init.zeros_(self.added.bias)

    def forward(self, x: Tensor, lines: Lines) -> Tensor:
        """(N, C, h, w) -> the same shape."""
        pooled = self.pooled(x)
        beams = self.beams(lines.beam_means(pooled))
        arcs = self.arcs(lines.arc_means(pooled))
        return lines.add(x, beams, arcs, self.added)


class GridLines:
    """Columns are beams and rows are arcs: of a polar picture, or where nobody knows."""

    def beam_means(self, x: Tensor) -> Tensor:
        """(N, C, h, w) -> (N, C, beams) means along each beam."""
        return x.float().mean(2)

    def arc_means(self, x: Tensor) -> Tensor:
        """(N, C, h, w) -> (N, C, arcs) means along each arc."""
        return x.float().mean(3)

    def add(self, x: Tensor, beams: Tensor, arcs: Tensor, added: nn.Conv2d) -> Tensor:
        """The features and `added` of what the beam and the arc of each cell have.

        x: (N, C, h, w).  beams: (N, D, beams).  arcs: (N, D, arcs).  added: 1x1, of 2 D channels;
        each line is convolved once, and not each of its cells.
        """
        weight, depth = added.weight[..., 0], beams.shape[1]
        along = functional.conv1d(beams, weight[:, :depth], added.bias)
        across = functional.conv1d(arcs, weight[:, depth:])
        return x + along[:, :, None, :] + across[:, :, :, None]


class MapLines:
    """The beams and arcs of a fan.

    beam, arc: (N, h * w) int64 numbers below `beams` and `arcs`.  weight: (N, 1, h * w), 0 outside
    the sector.
    """

    def __init__(self, beam: Tensor, arc: Tensor, weight: Tensor, shape: tuple[int, int]) -> None:
        self.beam, self.arc, self.weight, self.shape = beam, arc, weight, shape
        self.arcs, self.beams = shape

    @classmethod
    def of(
        cls, azimuth_rad: Tensor, range_fraction: Tensor, sector: Tensor, shape: tuple[int, int]
    ) -> MapLines:
        """From maps of the picture, (N, 1, H, W) each, for features of `shape` (h, w).

        The sector's bearings and ranges are divided evenly into w beams and h arcs.
        """
        planes = functional.interpolate(torch.cat([azimuth_rad, range_fraction, sector], 1), shape)
        bearing, radius, inside = (planes[:, n].flatten(1) for n in range(3))
        weight = (inside > 0).to(planes.dtype)
        return cls(
            _numbers(bearing, weight, shape[1]),
            _numbers(radius, weight, shape[0]),
            weight[:, None],
            shape,
        )

    def beam_means(self, x: Tensor) -> Tensor:
        """See `GridLines`."""
        return self._means(x, self.beam, self.beams)

    def arc_means(self, x: Tensor) -> Tensor:
        """See `GridLines`."""
        return self._means(x, self.arc, self.arcs)

    def add(self, x: Tensor, beams: Tensor, arcs: Tensor, added: nn.Conv2d) -> Tensor:
        """See `GridLines`."""
        spread = [self._spread(beams, self.beam), self._spread(arcs, self.arc)]
        found: Tensor = x + added(torch.cat(spread, dim=1))
        return found

    def _means(self, x: Tensor, numbers: Tensor, count: int) -> Tensor:
        flat, channels = x.float().flatten(2), x.shape[1]
        weight = self.weight.float()
        index = numbers[:, None]
        zeros = torch.zeros(x.shape[0], channels, count, device=x.device)
        total = zeros.scatter_add(2, index.expand(-1, channels, -1), flat * weight)
        cells = zeros[:, :1].scatter_add(2, index, weight)
        return total / cells.clamp_min(1)

    def _spread(self, along: Tensor, numbers: Tensor) -> Tensor:
        """(N, C, beams or arcs) -> (N, C, h, w): every cell gets what its line has."""
        index = numbers[:, None].expand(-1, along.shape[1], -1)
        return along.gather(2, index).reshape(*along.shape[:2], *self.shape)


Lines = GridLines | MapLines
"""The beams and arcs of the cells of a feature map."""


def _numbers(values: Tensor, weight: Tensor, count: int) -> Tensor:
    """(N, P) int64: which of `count` even steps between the extremes inside a value lies in."""
    inside = weight > 0
    least = values.masked_fill(~inside, torch.inf).amin(1, keepdim=True)
    most = values.masked_fill(~inside, -torch.inf).amax(1, keepdim=True)
    empty = ~inside.any(1, keepdim=True)
    least, most = least.masked_fill(empty, 0), most.masked_fill(empty, 1)
    step = (values - least) / (most - least).clamp_min(1e-6) * count
    return step.clamp(0, count - 1).long()
