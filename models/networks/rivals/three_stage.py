"""A network of three stages, after the abstract of Lu et al. (2023): quarters, halves, the whole.

Reference [19] of the SimNFND paper: a multi-stage network with supervised attention (SAM) and a
fusion of features across scales and stages (MCFF).  Neither its sizes nor its code are public; this
is written from the paper that these parts come from (Zamir et al., MPRNet: Multi-Stage Progressive
Image Restoration, CVPR 2021), much smaller.  Left out is what Lu et al. put around the network:
adaptive Gaussian smoothing before it, and after it a weighted fusion that corrects grey levels.

Stage 1 encodes the quarters of the image and decodes its halves, stage 2 encodes these and decodes
the whole, stage 3 stays at full resolution.  Each makes an image, and each is taught.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from ....factory.common.settings import STRICT
from ..network import Network, Pointwise, padded

_LEVELS = 3
_REDUCTION = 4
"""Of the channels inside the attention."""


@dataclass(frozen=True, config=STRICT)
class ThreeStageSettings:
    """Keys of conf/model/three_stage.yaml, which explains them."""

    kind: Literal["three_stage"]
    width: Annotated[int, Field(ge=4, le=256)]
    growth: Annotated[int, Field(ge=0, le=256)]
    blocks: Annotated[int, Field(ge=1, le=16)]
    full_blocks: Annotated[int, Field(ge=1, le=16)]

    @property
    def widths(self) -> tuple[int, ...]:
        """Channels at each resolution, from full to coarse."""
        return tuple(self.width + level * self.growth for level in range(_LEVELS))


class AttentionBlock(nn.Module):
    """Two convolutions whose channels are weighed by their means, added to what came in."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        inner = max(channels // _REDUCTION, 1)
        self.change = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1, bias=False),
            nn.PReLU(),
            nn.Conv2d(channels, channels, 3, padding=1, bias=False),
        )
        self.weigh = nn.Sequential(
            Pointwise(channels, inner), nn.ReLU(), Pointwise(inner, channels), nn.Sigmoid()
        )

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        change = self.change(x)
        weighed: Tensor = x + change * self.weigh(change.mean(dim=(2, 3), keepdim=True))
        return weighed


def _attention_blocks(channels: int, count: int) -> nn.Sequential:
    return nn.Sequential(*(AttentionBlock(channels) for _ in range(count)))


def _larger(before: int, after: int, factor: int = 2) -> nn.Sequential:
    """Channels first, then so many times as many pixels each way."""
    return nn.Sequential(Pointwise(before, after), nn.Upsample(None, factor, mode="bilinear"))


class StageFeatures(NamedTuple):
    """Features of a stage at each resolution, from full to coarse."""

    encoded: list[Tensor]
    decoded: list[Tensor]


class Encoder(nn.Module):
    """Features at each resolution, from full to coarse; features of the stage before are added."""

    def __init__(self, widths: tuple[int, ...], blocks: int, follows: bool) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(_attention_blocks(width, blocks) for width in widths)
        self.downs = nn.ModuleList(
            nn.Sequential(nn.AvgPool2d(2), Pointwise(fine, coarse))
            for fine, coarse in pairwise(widths)
        )
        fused = widths if follows else ()
        self.encoded = nn.ModuleList(Pointwise(width, width) for width in fused)
        self.decoded = nn.ModuleList(Pointwise(width, width) for width in fused)

    def forward(self, x: Tensor, previous: StageFeatures | None) -> list[Tensor]:
        """(N, C, H, W) and the features of the previous stage -> features of each level."""
        features: list[Tensor] = []
        for level, blocks in enumerate(self.blocks):
            if level:
                x = self.downs[level - 1](x)
            x = blocks(x)
            if previous is not None:
                x = x + self.encoded[level](previous.encoded[level])
                x = x + self.decoded[level](previous.decoded[level])
            features.append(x)
        return features


class Decoder(nn.Module):
    """Features at each resolution, from full to coarse, of those of an encoder."""

    def __init__(self, widths: tuple[int, ...], blocks: int) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(_attention_blocks(width, blocks) for width in widths)
        self.skips = nn.ModuleList(AttentionBlock(width) for width in widths[:-1])
        self.ups = nn.ModuleList(_larger(coarse, fine) for fine, coarse in pairwise(widths))

    def forward(self, encoded: list[Tensor]) -> list[Tensor]:
        """Features of each level -> the same shapes."""
        x = self.blocks[-1](encoded[-1])
        features = [x]
        for level in reversed(range(len(encoded) - 1)):
            x = self.blocks[level](self.ups[level](x) + self.skips[level](encoded[level]))
            features.insert(0, x)
        return features


class SupervisedAttention(nn.Module):
    """An image from the features of a stage, and the features weighed by that image (SAM)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.features = nn.Conv2d(width, width, 3, padding=1)
        self.residual = nn.Conv2d(width, 1, 3, padding=1)
        self.weigh = nn.Conv2d(1, width, 3, padding=1)

    def forward(self, features: Tensor, noisy: Tensor) -> tuple[Tensor, Tensor]:
        """(N, width, H, W) and (N, 1, H, W) -> the features for the next stage, the image."""
        image: Tensor = noisy + self.residual(features)
        weighted: Tensor = features + self.features(features) * torch.sigmoid(self.weigh(image))
        return weighted, image


class ThreeStage(Network):
    """Three images, each better than the previous one; the last is the result."""

    def __init__(self, settings: ThreeStageSettings) -> None:
        # Quarters have half the side, and that is halved at each downsampling.
        super().__init__(stride=2**_LEVELS)
        widths = settings.widths
        width = settings.width
        self.shallow = nn.ModuleList(
            nn.Sequential(nn.Conv2d(1, width, 3, padding=1), _attention_blocks(width, 1))
            for _ in range(3)
        )
        self.encoders = nn.ModuleList(
            Encoder(widths, settings.blocks, follows) for follows in (False, True)
        )
        self.decoders = nn.ModuleList(Decoder(widths, settings.blocks) for _ in range(2))
        self.supervised = nn.ModuleList(SupervisedAttention(width) for _ in range(2))
        self.joined = nn.ModuleList(Pointwise(2 * width, width) for _ in range(2))
        self.groups = nn.ModuleList(
            _attention_blocks(width, settings.full_blocks) for _ in range(_LEVELS)
        )
        self.encoded, self.decoded = (
            nn.ModuleList(
                _larger(wide, width, 2**level) if level else Pointwise(wide, width)
                for level, wide in enumerate(widths)
            )
            for _ in range(2)
        )
        self.outro = nn.Conv2d(width, 1, 3, padding=1)

    def restore(self, noisy: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`."""
        return self._restore_stages(noisy)[-1]

    def stages(self, noisy: Tensor, **extras: Tensor) -> list[Tensor]:
        """The image of every stage, (N, 1, H, W) each, for any H and W."""
        height, width = noisy.shape[-2:]
        images = self._restore_stages(padded(noisy, self.stride))
        return [image[..., :height, :width] for image in images]

    def _restore_stages(self, noisy: Tensor) -> list[Tensor]:
        halves = split(noisy, 2)
        encoded = self.encoders[0](self.shallow[0](split(halves, 3)), None)
        encoded = [join(x, 3) for x in encoded]
        decoded = self.decoders[0](encoded)
        features, first = self.supervised[0](decoded[0], halves)

        x = self.joined[0](torch.cat([self.shallow[1](halves), features], dim=1))
        encoded = self.encoders[1](x, StageFeatures(encoded, decoded))
        encoded = [join(x, 2) for x in encoded]
        decoded = self.decoders[1](encoded)
        features, second = self.supervised[1](decoded[0], noisy)

        x = self.joined[1](torch.cat([self.shallow[2](noisy), features], dim=1))
        for level, blocks in enumerate(self.groups):
            x = x + blocks(x)
            x = x + self.encoded[level](encoded[level]) + self.decoded[level](decoded[level])
        return [join(first, 2), second, noisy + self.outro(x)]


def split(x: Tensor, dim: int) -> Tensor:
    """(N, C, H, W) -> twice as many: all first halves along `dim`, then all second ones."""
    half = x.shape[dim] // 2
    return torch.cat([x.narrow(dim, 0, half), x.narrow(dim, half, half)])


def join(x: Tensor, dim: int) -> Tensor:
    """The way back from `split`."""
    count = x.shape[0] // 2
    return torch.cat([x[:count], x[count:]], dim)
