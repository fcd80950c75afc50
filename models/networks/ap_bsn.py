"""AP-BSN: a network that never sees the pixel that it predicts, for noise with a grain.

Lee, Son, Lee: AP-BSN: Self-Supervised Denoising for Real-World Images via Asymmetric PD and
Blind-Spot Network, CVPR 2022; the dilated blind-spot network in it is of Wu et al. (ECCV 2020).
Written from the papers, and much smaller.  A picture is taken apart into stride x stride pictures
of every stride-th pixel (pixel-shuffle downsampling): in training so far apart that neighbours
share no grain, in use nearer, so that detail stays.  Then the result is denoised again with a part
of its pixels noisy as they were, and the mean of several such passes is the picture.

One thing differs: those pixels are drawn at random there, and here are the points of a lattice that
moves from pass to pass, so that the same picture gives the same result.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn
from torch.nn import functional

from ...factory.settings import STRICT
from .network import Network, Pointwise

Stride = Annotated[int, Field(ge=1, le=16)]
PASSES = 7
"""Each takes one of seven lattices; the authors take eight passes with 16 % of the pixels."""


@dataclass(frozen=True, config=STRICT)
class APBSNSettings:
    """Keys of conf/model/ap_bsn.yaml.

    width: channels.  modules: dilated blocks of each of the two branches.
    train_stride, use_stride: of the downsampling in training and in use; the first wider than a
    speckle grain.  passes: of the refinement in use, 0 for none.
    channels: of the images, 1 or 3.
    """

    kind: Literal["ap_bsn"]
    width: Annotated[int, Field(ge=2, le=256)]
    modules: Annotated[int, Field(ge=1, le=16)]
    train_stride: Stride
    use_stride: Stride
    passes: Annotated[int, Field(ge=0, le=PASSES)]
    channels: Literal[1, 3] = 1


class Masked(nn.Conv2d):
    """A convolution of side x side pixels that leaves out the one in the middle."""

    mask: Tensor

    def __init__(self, channels: int, side: int) -> None:
        super().__init__(channels, channels, side, padding=side // 2)
        mask = torch.ones(1, 1, side, side)
        mask[..., side // 2, side // 2] = 0
        self.register_buffer("mask", mask, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        return functional.conv2d(x, self.weight * self.mask, self.bias, padding=self.padding)


class Dilated(nn.Module):
    """A 3x3 convolution with gaps and a pointwise one, added to what came in."""

    def __init__(self, channels: int, gap: int) -> None:
        super().__init__()
        self.near = nn.Conv2d(channels, channels, 3, padding=gap, dilation=gap)
        self.point = Pointwise(channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        changed: Tensor = x + self.point(functional.relu(self.near(x)))
        return changed


class BlindSpot(nn.Module):
    """(N, C, H, W) -> the same, every pixel from the others alone.

    Two branches: after a hole of one pixel in 3x3 or in 5x5, gaps of 2 or 3 keep it a hole.
    """

    def __init__(self, channels: int, width: int, modules: int) -> None:
        super().__init__()
        self.intro = Pointwise(channels, width)
        self.branches = nn.ModuleList(
            nn.Sequential(
                Masked(width, side),
                nn.ReLU(),
                *(Dilated(width, (side + 1) // 2) for _ in range(modules)),
                Pointwise(width, width),
                nn.ReLU(),
            )
            for side in (3, 5)
        )
        self.outro = nn.Sequential(
            Pointwise(2 * width, width),
            nn.ReLU(),
            Pointwise(width, width // 2),
            nn.ReLU(),
            Pointwise(width // 2, channels),
        )

    def forward(self, x: Tensor) -> Tensor:
        """See the class."""
        x = functional.relu(self.intro(x))
        predicted: Tensor = self.outro(torch.cat([branch(x) for branch in self.branches], dim=1))
        return predicted


class APBSN(Network):
    """The blind-spot network between downsampling and its inverse; predicts the image itself."""

    is_blind: ClassVar[bool] = True

    def __init__(self, settings: APBSNSettings) -> None:
        super().__init__(settings.channels, stride=1)
        self.settings = settings
        self.blind = BlindSpot(self.channels, settings.width, settings.modules)

    def restore(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, channels, H, W) -> the same; in training `restore_blind`."""
        if self.training:
            return self.restore_blind(noisy)
        smooth = self._apart(noisy, self.settings.use_stride)
        if not self.settings.passes:
            return smooth
        down = torch.arange(noisy.shape[-2], device=noisy.device)[:, None]
        right = torch.arange(noisy.shape[-1], device=noisy.device)
        lattice = (2 * down + 3 * right) % PASSES
        refined = [
            self.blind(torch.where(lattice == number, noisy, smooth))
            for number in range(self.settings.passes)
        ]
        return torch.stack(refined).mean(dim=0)

    def restore_blind(self, noisy: Tensor) -> Tensor:
        """(N, channels, H, W) -> the same, no pixel from itself or its neighbours."""
        return self._apart(noisy, self.settings.train_stride)

    def _apart(self, noisy: Tensor, stride: int) -> Tensor:
        """The blind-spot network on the pictures of every stride-th pixel."""
        if stride == 1:
            predicted: Tensor = self.blind(noisy)
            return predicted
        height, width = noisy.shape[-2:]
        # Zeros, for a copy of the last pixels would show their grain to those a stride away.
        margin = (0, -width % stride, 0, -height % stride)
        taken = functional.pixel_unshuffle(functional.pad(noisy, margin), stride)
        channels, phases, rest = self.channels, stride**2, taken.shape[-2:]
        apart = taken.reshape(-1, channels, phases, *rest).transpose(1, 2)
        done = self.blind(apart.reshape(-1, channels, *rest))
        done = done.reshape(-1, phases, channels, *rest).transpose(1, 2)
        together = functional.pixel_shuffle(done.reshape(-1, channels * phases, *rest), stride)
        return together[..., :height, :width]
