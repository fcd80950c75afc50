"""SID-TGAN, a transformer and convolution network that is trained against a discriminator.

After the abstract of Zhou, Tian, Zhou, Ning, Wang: SID-TGAN: A Transformer-Based Generative
Adversarial Network for Sonar Image Despeckling, Remote Sensing 15(20), 5072, 2023.  Its table of
layers is not public: what is from there is that transformer blocks (global features) and
convolutional blocks (local features) are fused in generator and discriminator, and that the
generator is trained for content, local texture style, global similarity and against the
discriminator.  Sizes, the places of the blocks and the exact terms are ours.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.parametrizations import spectral_norm

from ....factory.settings import STRICT
from ..network import LayerNorm, Network, Pointwise, down_and_up, residual_blocks, u_shape

NotNegative = Annotated[float, Field(ge=0)]
_DOWNSAMPLINGS = 3
_SLOPE = 0.2


@dataclass(frozen=True, config=STRICT)
class SIDTGANSettings:
    """Keys of conf/model/sid_tgan.yaml.

    width: channels of the generator at full resolution; they double at each of the three
    downsamplings.  blocks: fused blocks at the coarsest resolution.  heads: of their attention.
    critic_width: like width, of the discriminator.
    style, similarity, adversarial: weights of these terms of training, beside the `loss` group as
    the content term.
    """

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
            if getattr(self, name) * 2**_DOWNSAMPLINGS % self.heads:
                raise ValueError(
                    f"{name} {getattr(self, name)} makes {getattr(self, name) * 2**_DOWNSAMPLINGS} "
                    f"channels, which {self.heads} heads cannot share"
                )


class Attention(nn.Module):
    """Every place attends to every other (Vaswani et al. 2017), for pictures of any size.

    Places are known by a depthwise convolution before it (Chu et al., CPVT, 2021).
    """

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.place = nn.Conv2d(channels, channels, 3, padding=1, groups=channels)
        self.norm1, self.norm2 = LayerNorm(channels), LayerNorm(channels)
        self.together = Pointwise(channels, 3 * channels)
        self.project = Pointwise(channels, channels)
        self.feed = nn.Sequential(
            Pointwise(channels, 2 * channels), nn.GELU(), Pointwise(2 * channels, channels)
        )

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        count, channels, height, width = x.shape
        x = x + self.place(x)
        together = self.together(self.norm1(x))
        split = together.reshape(count, 3, self.heads, channels // self.heads, height * width)
        query, key, value = split.transpose(-2, -1).unbind(dim=1)
        mixed = functional.scaled_dot_product_attention(query, key, value)
        x = x + self.project(mixed.transpose(-2, -1).reshape(count, channels, height, width))
        fed: Tensor = self.feed(self.norm2(x))
        return x + fed


class Fused(nn.Module):
    """Global features of attention and local ones of convolutions, side by side, then one."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.everywhere = Attention(channels, heads)
        self.near = residual_blocks(channels, 1)
        self.fuse = Pointwise(2 * channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        fused: Tensor = self.fuse(torch.cat([self.everywhere(x), self.near(x)], dim=1))
        return x + fused


class SIDTGAN(Network):
    """The generator; predicts what to add to the noisy image."""

    adversarial: ClassVar[bool] = True
    betas: ClassVar[tuple[float, float]] = (0.5, 0.99)
    """Of both optimizers: a short memory, because the opponent moves (Radford et al. 2016)."""

    def __init__(self, settings: SIDTGANSettings) -> None:
        super().__init__(stride=2**_DOWNSAMPLINGS)
        self.settings = settings
        widths = [settings.width * 2**level for level in range(_DOWNSAMPLINGS + 1)]
        self.intro = nn.Conv2d(1, settings.width, 3, padding=1)
        levels = u_shape(widths, [1] * _DOWNSAMPLINGS)
        self.encoders, self.downs, self.ups, self.decoders = levels
        self.middle = nn.Sequential(
            *(Fused(widths[-1], settings.heads) for _ in range(settings.blocks))
        )
        self.outro = nn.Conv2d(settings.width, 1, 3, padding=1)

    def restore(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`."""
        x = self.intro(noisy)
        x = down_and_up(x, self.encoders, self.downs, self.middle, self.ups, self.decoders)
        residual: Tensor = self.outro(x)
        return noisy + residual

    def opponent(self) -> Discriminator:
        """The discriminator of this network, with fresh weights."""
        return Discriminator(self.settings)

    def critic_loss(
        self, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor, rng: Any
    ) -> Tensor:
        """What the discriminator learns by, of images (N, 1, H, W), the last without gradients."""
        return hinge(critic(noisy, clean)[0], critic(noisy, denoised)[0])

    def generator_loss(
        self, content: Tensor, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """What the network learns by: content, texture, global features, and the judgement."""
        judged, local, overall = critic(noisy, denoised)
        with torch.no_grad():
            _, true_local, true_overall = critic(noisy, clean)
        # A texture is the correlation of features over the image, wherever things lie.
        textures = zip(local, true_local, strict=True)
        style = torch.stack([(gram(a) - gram(b)).abs().mean() for a, b in textures]).mean()
        unlike = 1 - functional.cosine_similarity(overall, true_overall, dim=1).mean()
        weights = self.settings
        total: Tensor = (
            content
            + weights.style * style
            + weights.similarity * unlike
            - weights.adversarial * judged.mean()
        )
        return total


class Discriminator(nn.Module):
    """Tells, place by place, true clean images from denoised ones, beside the noisy image."""

    def __init__(self, settings: SIDTGANSettings) -> None:
        super().__init__()
        # The noisy image and the one to judge.
        widths = [2, *(settings.critic_width * 2**level for level in range(1, _DOWNSAMPLINGS + 1))]
        self.local = nn.ModuleList(
            spectral_norm(nn.Conv2d(before, after, 4, stride=2, padding=1))
            for before, after in pairwise(widths)
        )
        self.fused = Fused(widths[-1], settings.heads)
        self.judge = spectral_norm(nn.Conv2d(widths[-1], 1, 3, padding=1))

    def forward(self, noisy: Tensor, image: Tensor) -> tuple[Tensor, list[Tensor], Tensor]:
        """Judgement (N, 1, H/8, W/8), positive for true; local features; global ones (N, C).

        noisy, image: (N, 1, H, W), 16 pixels or more each way.
        """
        x = torch.cat([noisy, image], dim=1)
        features = []
        for layer in self.local:
            x = functional.leaky_relu(layer(x), _SLOPE)
            features.append(x)
        x = self.fused(x)
        judged: Tensor = self.judge(functional.leaky_relu(x, _SLOPE))
        return judged, features, x.mean(dim=(2, 3))


def hinge(true: Tensor, false: Tensor) -> Tensor:
    """Scalar hinge loss of the judgements (Lim, Ye 2017); 0 beyond +1 for true and -1 for false."""
    return functional.relu(1 - true).mean() + functional.relu(1 + false).mean()


def gram(features: Tensor) -> Tensor:
    """(N, C, C): means over pixels of products of features (N, C, H, W) (Gatys et al. 2016)."""
    flat = features.flatten(2)
    return flat @ flat.transpose(1, 2) / flat.shape[-1]
