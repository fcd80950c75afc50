"""DGP-SRGAN: the generator of SRGAN, trained against a critic with a penalty on its slope.

Shen et al. (2021), which the SimNFND paper names, enlarge sonar pictures by a super-resolution GAN
"with gradient penalty"; the paper was not at hand.  What its name says is public: SRGAN (Ledig et
al., CVPR 2017) and the penalty (Gulrajani et al., Improved Training of Wasserstein GANs, 2017).
Chosen here, because pictures are denoised and not enlarged: no upsampling, and the change of the
noisy picture is predicted; no batch normalisation, which the penalty rules out in the critic and
which ties a picture to its neighbours in the generator; fewer channels and blocks; the content term
is the `loss` group and no network for photographs (VGG).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, ClassVar, Literal

import numpy as np
import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from ....factory.settings import STRICT
from ..network import Network

NotNegative = Annotated[float, Field(ge=0)]
_HALVINGS = 3
_SLOPE = 0.2


@dataclass(frozen=True, config=STRICT)
class DGPSRGANSettings:
    """Keys of conf/model/dgp_srgan.yaml.

    width: channels of the generator.  blocks: its residual blocks.  critic_width: channels of the
    critic after its first halving; they double at each of the two others.
    adversarial: weight of the critic's judgement, beside the `loss` group as the content term.
    penalty: weight of the penalty in the training of the critic.
    """

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


class DGPSRGAN(Network):
    """The generator."""

    adversarial: ClassVar[bool] = True
    betas: ClassVar[tuple[float, float]] = (0.0, 0.9)
    """Of both optimizers: no momentum, as the authors of the penalty advise."""

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

    def restore(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same."""
        shallow = self.intro(noisy)
        residual: Tensor = self.outro(shallow + self.blocks(shallow))
        return noisy + residual

    def opponent(self) -> Critic:
        """The critic of this network, with fresh weights."""
        return Critic(self.settings)

    def critic_loss(
        self,
        critic: nn.Module,
        noisy: Tensor,
        clean: Tensor,
        denoised: Tensor,
        rng: np.random.Generator,
    ) -> Tensor:
        """It learns to value clean pictures above denoised ones, by as much as its slope allows.

        Images (N, 1, H, W), `denoised` without gradients.  The penalty holds its slope at 1.
        """
        difference: Tensor = critic(denoised).mean() - critic(clean).mean()
        # Slopes of slopes are too fine for half precision.
        with torch.autocast(clean.device.type, enabled=False):
            share = torch.from_numpy(rng.random((len(clean), 1, 1, 1), np.float32))
            mixed = clean.float().lerp(denoised.float(), share.to(clean.device))
            return difference + self.settings.penalty * penalty(critic, mixed)

    def generator_loss(
        self, content: Tensor, critic: nn.Module, noisy: Tensor, clean: Tensor, denoised: Tensor
    ) -> Tensor:
        """The network learns to be valued, beside the content."""
        judged: Tensor = critic(denoised).mean()
        return content - self.settings.adversarial * judged


class Critic(nn.Module):
    """A number for a picture, the larger the more it looks like a clean one."""

    def __init__(self, settings: DGPSRGANSettings) -> None:
        super().__init__()
        widths = [1, *(settings.critic_width * 2**level for level in range(_HALVINGS))]
        layers: list[nn.Module] = []
        for before, after in pairwise(widths):
            layers += [nn.Conv2d(before, after, 4, stride=2, padding=1), nn.LeakyReLU(_SLOPE)]
        self.layers = nn.Sequential(*layers, nn.Conv2d(widths[-1], 1, 3, padding=1))

    def forward(self, image: Tensor) -> Tensor:
        """(N, 1, H, W), 16 pixels or more each way -> (N,)."""
        judged: Tensor = self.layers(image).mean(dim=(1, 2, 3))
        return judged


def penalty(critic: nn.Module, images: Tensor) -> Tensor:
    """Scalar: mean of (length of the slope - 1)^2 at these images, (N, 1, H, W)."""
    images = images.detach().requires_grad_(True)
    (slope,) = torch.autograd.grad(critic(images).sum(), images, create_graph=True)
    # Off zero, where a length has no slope.
    length = (slope.square().sum(dim=(1, 2, 3)) + 1e-12).sqrt()
    return (length - 1).square().mean()
