"""Interference along bearings, told from what is radial and real by whole bearings.

A crop, and a convolution over pixels, never sees whether an echo along a bearing ends.  This head
sees statistics of whole bearings: interference crosses all ranges and fluctuates alike across its
width; a wall, a pile or a rope begins and ends; beam patterns, haze and steps of gain do not
fluctuate together.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional

from .bearing_view import BEARINGS, LEAST_SHARE, NODES, RANGES, SEGMENTS
from .blocks import zeroed
from .network import down_and_up

_ZONES = 8  # of the ranges in which fluctuation is compared
_LAGS = (2, 6, 16, 40)  # distances of bearings whose fluctuation is compared, cells
_TREND_ROWS = 9  # a mean over so many ranges is no fluctuation
_BRIGHTEST = 20.0  # of the image's mean
_DOUBTFUL = 0.12
_SURE = 0.25
"""Amounts, of the image's mean, up to which none is taken off, and from which all is."""
_FLOOR = 0.02  # grey value added to the mean of an image
_WIDTHS = (48, 64, 96, 96, 96)
_CHANNELS = 6 * SEGMENTS + 2 * _ZONES * len(_LAGS) + 2


class BearingHead(nn.Module):
    """How much interference an image holds along each bearing."""

    def __init__(self) -> None:
        super().__init__()
        self.intro = nn.Conv1d(_CHANNELS, _WIDTHS[0], 5, padding=2)
        self.encoders = nn.ModuleList(_LineBlock(width) for width in _WIDTHS[:-1])
        self.downs, self.ups = nn.ModuleList(), nn.ModuleList()
        for fine, coarse in pairwise(_WIDTHS):
            self.downs.append(nn.Conv1d(fine, coarse, 2, stride=2))
            self.ups.insert(0, nn.ConvTranspose1d(coarse, fine, 2, stride=2))
        self.middle = _LineBlock(_WIDTHS[-1])
        self.decoders = nn.ModuleList(_LineBlock(width) for width in reversed(_WIDTHS[:-1]))
        self.outro = zeroed(nn.Conv1d(_WIDTHS[0], 2 * NODES, 1))

    def forward(self, view: Tensor, width_rad: Tensor) -> Tensor:
        """(N, NODES, BEARINGS) grey values, below 0 too, of `bearing_view` (N, 2, ...).

        width_rad: (N, 1) of the sector.
        """
        grey = view[:, 0].float()
        known = view[:, 1].float()
        area = known.sum(dim=(1, 2)).clamp_min(1)
        level = ((grey * known).sum(dim=(1, 2)) / area + _FLOOR)[:, None, None]
        relative = (grey / level).clamp(0, _BRIGHTEST) * known
        scales = torch.cat([torch.log(level[:, 0]), torch.log(width_rad)], dim=1)
        means = _means(relative, known)
        features = torch.cat(
            [
                means,
                _levels(relative, known, means),
                _shared_fluctuation(relative, known),
                scales[:, :, None].expand(-1, -1, BEARINGS),
            ],
            dim=1,
        )
        x = down_and_up(
            self.intro(features), self.encoders, self.downs, self.middle, self.ups, self.decoders
        )
        # A part of what the bearing holds there, and an amount beside it.
        part, amount = self.outro(x).chunk(2, dim=1)
        held = functional.interpolate(
            means[:, None], (NODES, BEARINGS), mode="bilinear", align_corners=True
        )[:, 0]
        relative_nodes = part * held + amount
        if not self.training:
            # An image without interference must not change: what is doubtful stays.
            sure = (relative_nodes - _DOUBTFUL) / (_SURE - _DOUBTFUL)
            relative_nodes = relative_nodes * sure.clamp(0, 1)
        nodes: Tensor = relative_nodes * level
        return nodes


class _LineBlock(nn.Module):
    """Two convolutions along bearings, added to what came in."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv1d(channels, channels, 5, padding=2)
        self.second = zeroed(nn.Conv1d(channels, channels, 5, padding=2))

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, L) -> the same shape."""
        changed: Tensor = self.second(functional.relu(self.first(x)))
        return x + changed


def _means(relative: Tensor, known: Tensor) -> Tensor:
    """Means of segments of range where they are known, (N, SEGMENTS, BEARINGS)."""
    count = _parts(known, SEGMENTS).sum(2).clamp_min(1)
    return _parts(relative, SEGMENTS).sum(2) / count


def _levels(relative: Tensor, known: Tensor, mean: Tensor) -> Tensor:
    """Roots of mean, least, most and variance, and known part of segments, (N, 5 SEGMENTS, ...)."""
    x = _parts(relative, SEGMENTS)
    is_known = _parts(known, SEGMENTS)
    count = is_known.sum(2).clamp_min(1)
    least = (x + _BRIGHTEST * (1 - is_known)).amin(2)
    most = x.amax(2)
    variance = (x.square().sum(2) / count - mean.square()).clamp_min(0)
    roots = [torch.sqrt(values + 1e-4) for values in (mean, least, most)]
    return torch.cat([*roots, torch.sqrt(variance + 1e-4), is_known.mean(2)], dim=1)


def _shared_fluctuation(relative: Tensor, known: Tensor) -> Tensor:
    """Correlation along range with neighbouring bearings, (N, zones x lags x 2, BEARINGS)."""
    # In the root, in which speckle varies alike in bright and dim places.
    relative = torch.sqrt(relative + 1e-4)
    padded = functional.pad(relative[:, None], (0, 0, _TREND_ROWS // 2, _TREND_ROWS // 2))
    trend = functional.avg_pool2d(padded, (_TREND_ROWS, 1), stride=1)[:, 0]
    rough = _parts((relative - trend) * known, _ZONES)
    power = rough.square().mean(2) + 1e-4
    correlations = []
    for lag in _LAGS:
        product = (rough[..., lag:] * rough[..., :-lag]).mean(2)
        shared = product / torch.sqrt(power[..., lag:] * power[..., :-lag])
        correlations += [functional.pad(shared, (0, lag)), functional.pad(shared, (lag, 0))]
    return torch.cat(correlations, dim=1)


def _parts(plane: Tensor, count: int) -> Tensor:
    """(N, RANGES, BEARINGS) -> (N, count, ranges of a part, BEARINGS)."""
    return plane.reshape(-1, count, RANGES // count, BEARINGS)


def at_segments(nodes: Tensor) -> Tensor:
    """What the head states, at the middle of each segment of range, (N, SEGMENTS, BEARINGS)."""
    size = 2 * SEGMENTS + 1, BEARINGS
    stated = functional.interpolate(nodes[:, None], size, mode="bilinear", align_corners=True)
    return stated[:, 0, 1::2]


def remaining_share(nodes: Tensor, view: Tensor) -> Tensor:
    """(N, SEGMENTS, BEARINGS); see `bearing_view.remaining_share`."""
    held = _means(view[:, 0], view[:, 1]).clamp_min(1e-3)
    return (1 - at_segments(nodes).clamp_min(0) / held).clamp(LEAST_SHARE, 1)


def at_pixels(
    shares: Tensor, sector: Tensor, range_fraction: Tensor, azimuth_rad: Tensor
) -> Tensor:
    """(N, 1, H, W) of `remaining_share` at pixels with these maps.

    sector: (N, 4), as of `bearing_view.Sector`.
    """
    near, far, left, right = (sector[:, n, None, None, None] for n in range(4))
    down = 2 * (range_fraction - near) / (far - near) - 1
    across = 2 * (azimuth_rad - left) / (right - left) - 1
    places = torch.cat([across, down], dim=1).permute(0, 2, 3, 1)
    with torch.autocast(shares.device.type, enabled=False):
        return functional.grid_sample(
            shares.float()[:, None], places.float(), padding_mode="border", align_corners=False
        )


def interference_loss(nodes: Tensor, truth: Tensor) -> Tensor:
    """How far the head is from the interference that is there, scalar.

    nodes: as of `BearingHead`.  truth: (N, SEGMENTS, BEARINGS), as of `bearing_view.segment_means`.
    """
    error = at_segments(nodes) - truth
    deviation = (error.square().mean(dim=(1, 2)) + 1e-8).sqrt().mean()
    return deviation + error.abs().mean()
