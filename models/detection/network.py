"""The detector's network: residual blocks at strides 8 and 16, and heads at stride 4.

The heads follow CenterNet (Zhou et al. 2019, "Objects as Points") and FCOS (Tian et al. 2019): a
heat map of centres, distances to the four sides, and a class at each centre.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from .normalise import CHANNELS

_WIDTHS = (16, 24, 48, 80)  # channels at strides 2, 4, 8 and 16
_HEAD = 32
_RARE = -3.5  # logit of a centre before training: most cells hold none


class Outputs(NamedTuple):
    """Outputs of the network for N images of h x w cells.

    centre: (N, 1, h, w) logits.  sides: (N, 4, h, w), distances to left, top, right and bottom in
    cells, > 0.  classes: (N, K, h, w) logits.
    """

    centre: Tensor
    sides: Tensor
    classes: Tensor


class DetectorNetwork(nn.Module):
    """(N, 3, H, W) as `normalise` makes it -> Outputs at stride 4."""

    def __init__(self, class_count: int) -> None:
        super().__init__()
        stem, quarter, eighth, sixteenth = _WIDTHS
        self.class_count = class_count
        self.stem = _convolution(CHANNELS, stem, stride=2)
        self.quarter = nn.Sequential(
            _convolution(stem, quarter, stride=2), _convolution(quarter, quarter)
        )
        self.eighth = nn.Sequential(
            _convolution(quarter, eighth, stride=2), _Residual(eighth), _Residual(eighth)
        )
        self.sixteenth = nn.Sequential(
            _convolution(eighth, sixteenth, stride=2), _Residual(sixteenth), _Residual(sixteenth)
        )
        self.from_sixteenth = _convolution(sixteenth, _HEAD, size=1)
        self.from_eighth = _convolution(eighth, _HEAD, size=1)
        self.from_quarter = _convolution(quarter, _HEAD, size=1)
        self.merge_eighth = _Residual(_HEAD)
        self.merge_quarter = _convolution(_HEAD, _HEAD)
        self.heads = nn.Conv2d(_HEAD, 5 + class_count, 1)
        nn.init.normal_(self.heads.weight, std=0.01)
        bias = torch.zeros(5 + class_count)
        bias[0] = _RARE
        bias[1:5] = 1.0
        self.heads.bias = nn.Parameter(bias)

    def forward(self, x: Tensor) -> Outputs:
        """H and W must divide by DIVISOR."""
        return self.split(self.heads(self.features(x)))

    def features(self, x: Tensor) -> Tensor:
        """(N, 3, H, W) -> what the heads look at, (N, C, H / STRIDE, W / STRIDE)."""
        quarter = self.quarter(self.stem(x))
        eighth = self.eighth(quarter)
        sixteenth = self.sixteenth(eighth)
        merged = self.merge_eighth(
            _enlarged(self.from_sixteenth(sixteenth)) + self.from_eighth(eighth)
        )
        merged_quarter: Tensor = self.merge_quarter(_enlarged(merged) + self.from_quarter(quarter))
        return merged_quarter

    @staticmethod
    def split(values: Tensor) -> Outputs:
        """The outputs in the channels of the heads."""
        values = values.float()
        sides = torch.exp(values[:, 1:5].clamp(-3, 5))
        return Outputs(values[:, :1], sides, values[:, 5:])


class _Residual(nn.Module):
    """Two 3x3 convolutions and a skip; the shape stays."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = _convolution(channels, channels)
        self.second = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(channels)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same."""
        return functional.silu(x + self.norm(self.second(self.first(x))))


def _convolution(channels: int, out: int, *, stride: int = 1, size: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(channels, out, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(out),
        nn.SiLU(),
    )


def _enlarged(x: Tensor) -> Tensor:
    return functional.interpolate(x, scale_factor=2.0, mode="nearest")
