"""Restormer, a U-shaped transformer whose attention is between channels.

Zamir, Arora, Khan, Hayat, Khan, Yang: Restormer: Efficient Transformer for High-Resolution Image
Restoration, CVPR 2022.  Written from the paper.  The SimNFND paper denoises with a reduced one
(section 4.2: 48 channels, three downsamplings).
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn
from torch.nn import functional

from ...factory.common.settings import STRICT
from .network import LayerNorm, Network, Pointwise

Blocks = Annotated[int, Field(ge=0, le=64)]
Heads = Annotated[int, Field(ge=1, le=64)]


@dataclass(frozen=True, config=STRICT)
class RestormerSettings:
    """Keys of conf/model/restormer.yaml, which explains them."""

    kind: Literal["restormer"]
    width: Annotated[int, Field(ge=2, le=256)]
    blocks: tuple[Blocks, ...]
    refinement: Blocks
    heads: tuple[Heads, ...]
    expansion: Annotated[float, Field(gt=0, le=16)]

    def __post_init__(self) -> None:
        if len(self.blocks) < 2 or len(self.heads) != len(self.blocks):
            raise ValueError(
                f"blocks has {len(self.blocks)} resolutions and heads {len(self.heads)}; "
                "give two or more, and as many of each"
            )
        if self.width % 2:
            raise ValueError("width must be even: a downsampling halves it before it doubles")
        for level, heads in enumerate(self.heads):
            if self.width * 2**level % heads:
                raise ValueError(
                    f"{self.width * 2**level} channels cannot be shared by {heads} heads"
                )


class ChannelAttention(nn.Module):
    """Multi-Dconv head transposed attention, MDTA (section 3.1).

    Queries, keys and values come from a pointwise and a depthwise convolution; the attention map
    is channels x channels, so its cost grows with the number of pixels and not with its square.
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.temperature = nn.Parameter(torch.ones(heads, 1, 1))
        self.point = Pointwise(channels, 3 * channels, bias=False)
        self.depth = nn.Conv2d(
            3 * channels, 3 * channels, 3, padding=1, groups=3 * channels, bias=False
        )
        self.project = Pointwise(channels, channels, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        count, channels, height, width = x.shape
        # Channels last, as the convolutions have them: (N, heads, H W, C / heads).
        together = self.depth(self.point(x)).permute(0, 2, 3, 1)
        split = together.reshape(count, height * width, 3, self.heads, channels // self.heads)
        query, key, value = split.permute(2, 0, 3, 1, 4)
        # Unit vectors over the pixels: the products are cosines, and the temperature scales them.
        # Scaling the small matrix by the lengths is the same as scaling the vectors before.
        query_lengths, key_lengths = (
            torch.linalg.vector_norm(vectors, dim=-2, keepdim=True).clamp_min(1e-6)
            for vectors in (query, key)
        )
        lengths = query_lengths.transpose(-2, -1) * key_lengths
        cosines = query.transpose(-2, -1) @ key / lengths
        attention = (cosines * self.temperature).softmax(dim=-1)
        mixed = (value @ attention.transpose(-2, -1)).transpose(1, 2)
        mixed = mixed.reshape(count, height, width, channels).permute(0, 3, 1, 2)
        projected: Tensor = self.project(mixed)
        return projected


class GatedFeedForward(nn.Module):
    """Gated-Dconv feed-forward network, GDFN (section 3.2)."""

    def __init__(self, channels: int, expansion: float) -> None:
        super().__init__()
        inner = int(channels * expansion)
        self.point = Pointwise(channels, 2 * inner, bias=False)
        self.depth = nn.Conv2d(2 * inner, 2 * inner, 3, padding=1, groups=2 * inner, bias=False)
        self.project = Pointwise(inner, channels, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        first, second = self.depth(self.point(x)).chunk(2, dim=1)
        projected: Tensor = self.project(functional.gelu(first) * second)
        return projected


class TransformerBlock(nn.Module):
    """Channel attention, then the gated network, each normalised before and added to its input."""

    def __init__(self, channels: int, heads: int, expansion: float) -> None:
        super().__init__()
        self.norm1 = LayerNorm(channels, bias=False)
        self.attention = ChannelAttention(channels, heads)
        self.norm2 = LayerNorm(channels, bias=False)
        self.feed = GatedFeedForward(channels, expansion)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        x = x + self.attention(self.norm1(x))
        fed: Tensor = self.feed(self.norm2(x))
        return x + fed


class Restormer(Network):
    """Encoder and decoder of transformer blocks that predict what to add to the noisy image."""

    def __init__(self, settings: RestormerSettings) -> None:
        super().__init__(stride=2 ** (len(settings.blocks) - 1))
        width = settings.width
        levels = len(settings.blocks)

        def stack(channels: int, count: int, level: int) -> nn.Sequential:
            sizes = channels, settings.heads[level], settings.expansion
            return nn.Sequential(*(TransformerBlock(*sizes) for _ in range(count)))

        self.embed = nn.Conv2d(1, width, 3, padding=1, bias=False)
        self.encoders = nn.ModuleList()
        self.downs = nn.ModuleList()
        for level in range(levels - 1):
            channels = width * 2**level
            self.encoders.append(stack(channels, settings.blocks[level], level))
            halved = nn.Conv2d(channels, channels // 2, 3, padding=1, bias=False)
            self.downs.append(nn.Sequential(halved, nn.PixelUnshuffle(2)))
        coming = width * 2 ** (levels - 1)
        self.latent = stack(coming, settings.blocks[-1], levels - 1)
        self.ups, self.fusions, self.decoders = (nn.ModuleList() for _ in range(3))
        for level in reversed(range(levels - 1)):
            channels = width * 2**level
            wider = nn.Conv2d(coming, 4 * channels, 3, padding=1, bias=False)
            self.ups.append(nn.Sequential(wider, nn.PixelShuffle(2)))
            # At full resolution skip and decoder stay side by side (section 3).
            self.fusions.append(
                Pointwise(2 * channels, channels, bias=False) if level else nn.Identity()
            )
            coming = channels if level else 2 * channels
            self.decoders.append(stack(coming, settings.blocks[level], level))
        self.refine = stack(coming, settings.refinement, 0)
        self.output = nn.Conv2d(coming, 1, 3, padding=1, bias=False)

    def restore(self, noisy: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`."""
        x = self.embed(noisy)
        skips = []
        for blocks, down in zip(self.encoders, self.downs, strict=True):
            x = blocks(x)
            skips.append(x)
            x = down(x)
        x = self.latent(x)
        for up, fuse, blocks in zip(self.ups, self.fusions, self.decoders, strict=True):
            x = blocks(fuse(torch.cat([up(x), skips.pop()], dim=1)))
        residual: Tensor = self.output(self.refine(x))
        return noisy + residual
