"""DGP-SRGAN, after its name: the generator of SRGAN, trained against a critic with a penalty.

Shen et al. (2021), reference [17] of the SimNFND paper, enlarge sonar images by a super-resolution
GAN "with gradient penalty"; the paper was not at hand.  What its name says is public: SRGAN (Ledig
et al., CVPR 2017) and the penalty (Gulrajani et al., Improved Training of Wasserstein GANs, 2017).

Chosen here, because images are denoised and not enlarged: no upsampling, and the change of the
noisy image is predicted; no batch normalisation, which the penalty rules out in the critic; fewer
channels and blocks; the content term is the `loss` group instead of a network for camera images.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from ....factory.common.settings import STRICT
from .adversary import AdversarialNetwork

NotNegative = Annotated[float, Field(ge=0)]
_HALVINGS = 3
_SLOPE = 0.2


@dataclass(frozen=True, config=STRICT)
class DGPSRGANSettings:
    """Keys of conf/model/dgp_srgan.yaml, which explains them."""

    kind: Literal["dgp_srgan"]
    width: Annotated[int, Field(ge=1, le=256)]
    blocks: Annotated[int, Field(ge=1, le=64)]
    critic_width: Annotated[int, Field(ge=1, le=256)]
    adversarial: NotNegative
    penalty: NotNegative


class Residual(nn.Module):
    """Two convolutions with a learned slope between them, added to what came in."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.change = nn.Sequential(
            nn.Conv2d(channels, channels, 3, padding=1),
            nn.PReLU(),
            nn.Conv2d(channels, channels, 3, padding=1),
        )

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        changed: Tensor = x + self.change(x)
        return changed


class DGPSRGAN(AdversarialNetwork):
    """The generator."""

    critic_betas: ClassVar[tuple[float, float]] = (0.0, 0.9)
    """No momentum, as the authors of the penalty advise."""

    def __init__(self, settings: DGPSRGANSettings) -> None:
        super().__init__(stride=1)
        self.settings = settings
        width = settings.width
        self.intro = nn.Sequential(nn.Conv2d(1, width, 9, padding=4), nn.PReLU())
        self.blocks = nn.Sequential(
            *(Residual(width) for _ in range(settings.blocks)),
            nn.Conv2d(width, width, 3, padding=1),
        )
        self.outro = nn.Conv2d(width, 1, 9, padding=4)

    def restore(self, noisy: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same."""
        shallow = self.intro(noisy)
        residual: Tensor = self.outro(shallow + self.blocks(shallow))
        return noisy + residual

    def build_critic(self) -> Critic:
        """The critic of this network, with fresh weights."""
        return Critic(self.settings)

    def critic_loss(
        self, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """The critic learns to value clean images above denoised ones, as its slope allows.

        The penalty holds its slope at 1.
        """
        difference: Tensor = critic(denoised).mean() - critic(clean).mean()
        # Slopes of slopes are too fine for 16 bits.
        with torch.autocast(clean.device.type, enabled=False):
            share = torch.rand(len(clean), 1, 1, 1).to(clean.device)
            mixed = clean.float().lerp(denoised.float(), share)
            return difference + self.settings.penalty * slope_penalty(critic, mixed)

    def generator_loss(
        self, content: Tensor, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """The network learns to be valued, beside the content."""
        value: Tensor = critic(denoised).mean()
        return content - self.settings.adversarial * value


class Critic(nn.Module):
    """A number for an image, the larger the more it looks like a clean one."""

    def __init__(self, settings: DGPSRGANSettings) -> None:
        super().__init__()
        widths = [1, *(settings.critic_width * 2**level for level in range(_HALVINGS))]
        layers: list[nn.Module] = []
        for before, after in pairwise(widths):
            layers += [nn.Conv2d(before, after, 4, stride=2, padding=1), nn.LeakyReLU(_SLOPE)]
        self.layers = nn.Sequential(*layers, nn.Conv2d(widths[-1], 1, 3, padding=1))

    def forward(self, image: Tensor) -> Tensor:
        """(N, 1, H, W), 16 pixels or more each way -> (N,)."""
        value: Tensor = self.layers(image).mean(dim=(1, 2, 3))
        return value


def slope_penalty(critic: nn.Module, images: Tensor) -> Tensor:
    """Scalar: mean of (length of the critic's slope - 1)^2 at these images, (N, 1, H, W)."""
    images = images.detach().requires_grad_(True)
    (slope,) = torch.autograd.grad(critic(images).sum(), images, create_graph=True)
    # The length has no slope at zero.
    length = (slope.square().sum(dim=(1, 2, 3)) + 1e-12).sqrt()
    return (length - 1).square().mean()
