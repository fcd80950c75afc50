"""NAFNet, a restoration network without nonlinear activations.

Chen, Chu, Zhang, Sun: Simple Baselines for Image Restoration, ECCV 2022.  Written from the paper.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from ...factory.common.settings import STRICT
from .network import LayerNorm, Network, Pointwise, down_and_up

Blocks = Annotated[int, Field(ge=0, le=64)]


@dataclass(frozen=True, config=STRICT)
class NAFNetSettings:
    """Keys of conf/model/nafnet.yaml, which explains them."""

    kind: Literal["nafnet"]
    width: Annotated[int, Field(ge=2, le=256)]
    encoder: tuple[Blocks, ...]
    middle: Blocks
    decoder: tuple[Blocks, ...]

    def __post_init__(self) -> None:
        if not self.encoder or len(self.encoder) != len(self.decoder):
            raise ValueError(
                f"encoder has {len(self.encoder)} levels and decoder {len(self.decoder)}; "
                "give one or more, and as many of each"
            )


def gate(x: Tensor) -> Tensor:
    """SimpleGate: one half of the channels times the other, (N, 2C, H, W) -> (N, C, H, W)."""
    first, second = x.chunk(2, dim=1)
    return first * second


class GatedBlock(nn.Module):
    """A gated depthwise convolution with channel attention, then a gated pointwise network.

    Each half is a residual that starts as nothing (scale 0), so a deep network trains from the
    identity.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.norm1 = LayerNorm(channels)
        self.expand = Pointwise(channels, 2 * channels)
        self.depthwise = nn.Conv2d(2 * channels, 2 * channels, 3, padding=1, groups=2 * channels)
        self.attention = nn.Linear(channels, channels)
        self.project = Pointwise(channels, channels)
        self.scale1 = nn.Parameter(torch.zeros(1, channels, 1, 1))
        self.norm2 = LayerNorm(channels)
        self.feed = Pointwise(channels, 2 * channels)
        self.reduce = Pointwise(channels, channels)
        self.scale2 = nn.Parameter(torch.zeros(1, channels, 1, 1))

    def forward(self, x: Tensor) -> Tensor:
        """Features of the same shape."""
        y = gate(self.depthwise(self.expand(self.norm1(x))))
        y = y * self.attention(y.mean(dim=(2, 3)))[:, :, None, None]
        x = x + self.scale1 * self.project(y)
        fed: Tensor = self.reduce(gate(self.feed(self.norm2(x))))
        return x + self.scale2 * fed


class NAFNet(Network):
    """U-shaped stack of blocks that predicts what to add to the noisy image."""

    def __init__(self, settings: NAFNetSettings) -> None:
        super().__init__(stride=2 ** len(settings.encoder))
        channels = settings.width
        self.intro = nn.Conv2d(1, channels, 3, padding=1)
        self.encoders = nn.ModuleList()
        self.downs = nn.ModuleList()
        for count in settings.encoder:
            self.encoders.append(_blocks(channels, count))
            self.downs.append(nn.Conv2d(channels, 2 * channels, 2, stride=2))
            channels *= 2
        self.middle = _blocks(channels, settings.middle)
        self.ups = nn.ModuleList()
        self.decoders = nn.ModuleList()
        for count in settings.decoder:
            self.ups.append(
                nn.Sequential(Pointwise(channels, 2 * channels, bias=False), nn.PixelShuffle(2))
            )
            channels //= 2
            self.decoders.append(_blocks(channels, count))
        self.outro = nn.Conv2d(channels, 1, 3, padding=1)

    def restore(self, noisy: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`."""
        x = self.intro(noisy)
        x = down_and_up(x, self.encoders, self.downs, self.middle, self.ups, self.decoders)
        residual: Tensor = self.outro(x)
        return noisy + residual


def _blocks(channels: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(GatedBlock(channels) for _ in range(count)))
