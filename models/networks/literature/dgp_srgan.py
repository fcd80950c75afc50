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
    channels: of the images, 1 or 3.
    """

    kind: Literal["dgp_srgan"]
    width: Annotated[int, Field(ge=1, le=256)]
    blocks: Annotated[int, Field(ge=1, le=64)]
    critic_width: Annotated[int, Field(ge=1, le=256)]
    adversarial: NotNegative
    penalty: NotNegative
    channels: Literal[1, 3] = 1


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

    def __init__(self, settings: DGPSRGANSettings) -> None:
        super().__init__(settings.channels, stride=1)
        self.settings = settings
        width = settings.width
        self.intro = nn.Sequential(nn.Conv2d(self.channels, width, 9, padding=4), nn.PReLU())
        self.blocks = nn.Sequential(
            *(Residual(width) for _ in range(settings.blocks)),
            nn.Conv2d(width, width, 3, padding=1),
        )
        self.outro = nn.Conv2d(width, self.channels, 9, padding=4)

    def restore(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, channels, H, W) -> the same."""
        shallow = self.intro(noisy)
        residual: Tensor = self.outro(shallow + self.blocks(shallow))
        return noisy + residual


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
