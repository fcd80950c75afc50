"""A residual U-Net: plain 3x3 convolutions, for comparison.

The U of Ronneberger, Fischer, Brox (MICCAI 2015) with the residual blocks of He et al. (CVPR 2016)
without normalisation, as denoising networks use them (Zhang et al., DRUNet, TPAMI 2021).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from ...factory.settings import STRICT
from .network import Network, down_and_up, residual_blocks, u_shape


@dataclass(frozen=True, config=STRICT)
class UNetSettings:
    """Keys of conf/model/unet.yaml.

    widths: channels at each resolution, from full to coarse.
    blocks: residual blocks at each resolution, on the way down and again on the way up.
    """

    kind: Literal["unet"]
    widths: tuple[Annotated[int, Field(ge=1, le=1024)], ...]
    blocks: Annotated[int, Field(ge=1, le=16)]

    def __post_init__(self) -> None:
        if len(self.widths) < 2:
            raise ValueError("widths must name two resolutions or more")


class UNet(Network):
    """Down and up again with added skips; predicts what to add to the noisy image."""

    def __init__(self, settings: UNetSettings) -> None:
        widths, blocks = settings.widths, settings.blocks
        super().__init__(stride=2 ** (len(widths) - 1))
        self.intro = nn.Conv2d(1, widths[0], 3, padding=1)
        levels = u_shape(widths, [blocks] * len(widths))
        self.encoders, self.downs, self.ups, self.decoders = levels
        self.middle = residual_blocks(widths[-1], blocks)
        self.outro = nn.Conv2d(widths[0], 1, 3, padding=1)

    def restore(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`."""
        x = self.intro(noisy)
        x = down_and_up(x, self.encoders, self.downs, self.middle, self.ups, self.decoders)
        residual: Tensor = self.outro(x)
        return noisy + residual
