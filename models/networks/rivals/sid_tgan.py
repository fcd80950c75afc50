"""SID-TGAN, after the abstract: transformer and convolutions, trained against a discriminator.

Zhou, Tian, Zhou, Ning, Wang: SID-TGAN: A Transformer-Based Generative Adversarial Network for Sonar
Image Despeckling, Remote Sensing 15(20), 5072, 2023; the SimNFND paper compares with it in Figure
14.  From there: transformer blocks (global features) and convolutional blocks (local features) are
fused in generator and discriminator, and the generator is trained for content, local texture style,
global similarity and against the discriminator.  Sizes, places of the blocks and the exact terms
are ours.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, NamedTuple

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import spectral_norm

from ....factory.common.settings import STRICT
from ..blocks import residual_blocks
from ..network import LayerNorm, Pointwise, down_and_up
from .adversary import AdversarialNetwork

NotNegative = Annotated[float, Field(ge=0)]
_DOWNSAMPLINGS = 3
_SLOPE = 0.2


@dataclass(frozen=True, config=STRICT)
class SIDTGANSettings:
    """Keys of conf/model/sid_tgan.yaml, which explains them."""

    kind: Literal["sid_tgan"]
    width: Annotated[int, Field(ge=2, le=128)]
    blocks: Annotated[int, Field(ge=1, le=16)]
    heads: Annotated[int, Field(ge=1, le=16)]
    critic_width: Annotated[int, Field(ge=2, le=128)]
    style: NotNegative
    similarity: NotNegative
    adversarial: NotNegative

    def __post_init__(self) -> None:
        for name in ("width", "critic_width"):
            width = getattr(self, name)
            channels = width * 2**_DOWNSAMPLINGS
            if channels % self.heads:
                raise ValueError(
                    f"{name} {width} makes {channels} channels, which {self.heads} heads cannot "
                    "share"
                )


class Attention(nn.Module):
    """Every place attends to every other (Vaswani et al. 2017), for images of any size.

    Places are known by a depthwise convolution before it (Chu et al., CPVT, 2021).
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.place = nn.Conv2d(channels, channels, 3, padding=1, groups=channels)
        self.norm1 = LayerNorm(channels)
        self.norm2 = LayerNorm(channels)
        self.queries_keys_values = Pointwise(channels, 3 * channels)
        self.project = Pointwise(channels, channels)
        self.feed = nn.Sequential(
            Pointwise(channels, 2 * channels), nn.GELU(), Pointwise(2 * channels, channels)
        )

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        count, channels, height, width = x.shape
        x = x + self.place(x)
        features = self.queries_keys_values(self.norm1(x))
        split = features.reshape(count, 3, self.heads, channels // self.heads, height * width)
        query, key, value = split.transpose(-2, -1).unbind(dim=1)
        mixed = functional.scaled_dot_product_attention(query, key, value)
        x = x + self.project(mixed.transpose(-2, -1).reshape(count, channels, height, width))
        fed: Tensor = self.feed(self.norm2(x))
        return x + fed


class FusedFeatures(nn.Module):
    """Global features of attention and local ones of convolutions, side by side, then fused."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.attention = Attention(channels, heads)
        self.convolutions = residual_blocks(channels, 1)
        self.fuse = Pointwise(2 * channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        both = torch.cat([self.attention(x), self.convolutions(x.clone())], dim=1)
        fused: Tensor = self.fuse(both)
        return x + fused


class SIDTGAN(AdversarialNetwork):
    """The generator; predicts what to add to the noisy image."""

    def __init__(self, settings: SIDTGANSettings) -> None:
        super().__init__(stride=2**_DOWNSAMPLINGS)
        self.settings = settings
        widths = [settings.width * 2**level for level in range(_DOWNSAMPLINGS + 1)]
        self.intro = nn.Conv2d(1, settings.width, 3, padding=1)
        self.encoders, self.downs, self.ups, self.decoders = (nn.ModuleList() for _ in range(4))
        for fine, coarse in pairwise(widths):
            self.encoders.append(residual_blocks(fine, 1))
            self.downs.append(nn.Conv2d(fine, coarse, 2, stride=2))
            self.ups.insert(0, nn.ConvTranspose2d(coarse, fine, 2, stride=2))
            self.decoders.insert(0, residual_blocks(fine, 1))
        self.middle = nn.Sequential(
            *(FusedFeatures(widths[-1], settings.heads) for _ in range(settings.blocks))
        )
        self.outro = nn.Conv2d(settings.width, 1, 3, padding=1)

    def restore(self, noisy: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`."""
        x = self.intro(noisy)
        x = down_and_up(x, self.encoders, self.downs, self.middle, self.ups, self.decoders)
        residual: Tensor = self.outro(x)
        return noisy + residual

    def build_critic(self) -> Discriminator:
        """The discriminator of this network, with fresh weights."""
        return Discriminator(self.settings)

    def critic_loss(
        self, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """Hinge loss of its judgements of clean and of denoised images."""
        return hinge(critic(noisy, clean).places, critic(noisy, denoised).places)

    def generator_loss(
        self, content: Tensor, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """Content, texture, global features, and the judgement of the discriminator."""
        fake = critic(noisy, denoised)
        with torch.no_grad():
            true = critic(noisy, clean)
        # A texture is the correlation of features over the image, wherever things lie.
        textures = [
            (gram(features) - gram(true_features)).abs().mean()
            for features, true_features in zip(fake.local, true.local, strict=True)
        ]
        style = torch.stack(textures).mean()
        unlike = 1 - functional.cosine_similarity(fake.overall, true.overall, dim=1).mean()
        weights = self.settings
        total: Tensor = content + weights.style * style + weights.similarity * unlike
        judgement: Tensor = fake.places.mean()
        return total - weights.adversarial * judgement


class Judgement(NamedTuple):
    """What the discriminator says of N images.

    places: (N, 1, H/8, W/8), positive where an image looks clean.  local: features of its
    first layers.  overall: (N, C) means of the last ones.
    """

    places: Tensor
    local: list[Tensor]
    overall: Tensor


class Discriminator(nn.Module):
    """Tells clean images from denoised ones, place by place, beside the noisy image."""

    def __init__(self, settings: SIDTGANSettings) -> None:
        super().__init__()
        # The noisy image and the one to judge.
        widths = [2, *(settings.critic_width * 2**level for level in range(1, _DOWNSAMPLINGS + 1))]
        self.local = nn.ModuleList(
            spectral_norm(nn.Conv2d(before, after, 4, stride=2, padding=1))
            for before, after in pairwise(widths)
        )
        self.fused = FusedFeatures(widths[-1], settings.heads)
        self.judge = spectral_norm(nn.Conv2d(widths[-1], 1, 3, padding=1))

    def forward(self, noisy: Tensor, image: Tensor) -> Judgement:
        """Judge images beside their noisy ones.

        noisy, image: (N, 1, H, W), 16 pixels or more each way.
        """
        x = torch.cat([noisy, image], dim=1)
        local = []
        for layer in self.local:
            x = functional.leaky_relu(layer(x), _SLOPE)
            local.append(x)
        x = self.fused(x)
        places: Tensor = self.judge(functional.leaky_relu(x, _SLOPE))
        return Judgement(places, local, x.mean(dim=(2, 3)))


def hinge(of_clean: Tensor, of_denoised: Tensor) -> Tensor:
    """Scalar hinge loss of judgements (Lim, Ye 2017); 0 beyond +1 for clean, -1 for denoised."""
    return functional.relu(1 - of_clean).mean() + functional.relu(1 + of_denoised).mean()


def gram(features: Tensor) -> Tensor:
    """(N, C, C): means over pixels of products of features (N, C, H, W) (Gatys et al. 2016)."""
    flat = features.flatten(2)
    return flat @ flat.transpose(1, 2) / flat.shape[-1]
