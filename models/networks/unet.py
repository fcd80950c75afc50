"""A residual U-Net: plain 3x3 convolutions, for comparison.

The U of Ronneberger, Fischer, Brox (MICCAI 2015) with the residual blocks of He et al. (CVPR 2016)
without normalisation, as denoising networks use them (Zhang et al., DRUNet, TPAMI 2021).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn
from torch.nn import functional

from ...factory.settings import STRICT
from .network import Network, down_and_up


@dataclass(frozen=True, config=STRICT)
class UNetSettings:
    """Keys of conf/model/unet.yaml.

    widths: channels at each resolution, from full to coarse.
    blocks: residual blocks at each resolution, on the way down and again on the way up.
    channels: of the images, 1 or 3.
    """

    kind: Literal["unet"]
    widths: tuple[Annotated[int, Field(ge=1, le=1024)], ...]
    blocks: Annotated[int, Field(ge=1, le=16)]
    channels: Literal[1, 3] = 1

    def __post_init__(self) -> None:
        if len(self.widths) < 2:
            raise ValueError("widths must name two resolutions or more")


class ResidualBlock(nn.Module):
    """Two convolutions, added to what came in; it starts as the identity."""

    def __init__(self, first: nn.Conv2d, second: nn.Conv2d) -> None:
        super().__init__()
        self.first, self.second = first, second
        nn.init.zeros_(self.second.weight)
        assert self.second.bias is not None
        nn.init.zeros_(self.second.bias)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        changed: Tensor = self.second(functional.relu(self.first(x), inplace=True))
        return changed.add_(x)


def residual_blocks(channels: int, count: int) -> nn.Sequential:
    """So many of them of 3x3, one after another."""

    def convolution() -> nn.Conv2d:
        return nn.Conv2d(channels, channels, 3, padding=1)

    return nn.Sequential(*(ResidualBlock(convolution(), convolution()) for _ in range(count)))


class UNet(Network):
    """Down and up again with added skips; predicts what to add to the noisy image."""

    def __init__(self, settings: UNetSettings) -> None:
        widths, blocks = settings.widths, settings.blocks
        super().__init__(settings.channels, stride=2 ** (len(widths) - 1))
        self.intro = nn.Conv2d(self.channels, widths[0], 3, padding=1)
        self.encoders, self.downs = nn.ModuleList(), nn.ModuleList()
        self.ups, self.decoders = nn.ModuleList(), nn.ModuleList()
        for fine, coarse in pairwise(widths):
            self.encoders.append(residual_blocks(fine, blocks))
            self.downs.append(nn.Conv2d(fine, coarse, 2, stride=2))
            self.ups.insert(0, nn.ConvTranspose2d(coarse, fine, 2, stride=2))
            self.decoders.insert(0, residual_blocks(fine, blocks))
        self.middle = residual_blocks(widths[-1], blocks)
        self.outro = nn.Conv2d(widths[0], self.channels, 3, padding=1)

    def restore(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, channels, H, W) -> the same; H and W divide by `stride`."""
        x = self.intro(noisy)
        x = down_and_up(x, self.encoders, self.downs, self.middle, self.ups, self.decoders)
        residual: Tensor = self.outro(x)
        return noisy + residual
