"""Self-supervised despeckling in the logarithm, after Pillai, Savner and Sahoo (2026).

"Physics-Guided Self-Supervised Statistical Residual Learning for Sonar Despeckling with Improved
Generalization", arXiv:2605.24716: the network predicts the speckle of the logarithm.  It learns
from noisy images alone, because what it takes away must have the statistics of speckle: mean 0, a
given variance, no structure where the image is even; and the image must stay near a median.

Written from the paper and the description of its training; sizes and weights of the terms are the
authors', the schedule of the training is `conf/models.yaml`.
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn
from torch.nn import functional

from ....factory.common.settings import STRICT
from ..network import LayerNorm, Network, Pointwise

NotNegative = Annotated[float, Field(ge=0)]
_FLOOR = 1e-6  # grey level whose logarithm black gets
_MEDIAN_PX = 5
_LARGEST_RATIO = 4.0  # of the noisy image over the denoised one, and its inverse
_EDGE = 0.01  # difference of grey levels from which on an edge may show in the residual
_GUIDED = 0.6  # part of the training in which the weight of the median grows


@dataclass(frozen=True, config=STRICT)
class LogResidualSettings:
    """Keys of conf/model/log_residual.yaml, which explains them."""

    kind: Literal["log_residual"]
    width: Annotated[int, Field(ge=1, le=512)]
    blocks: Annotated[int, Field(ge=1, le=16)]
    variance: Annotated[float, Field(gt=0)]
    statistics: NotNegative
    structure: NotNegative
    median: NotNegative


class WideBlock(nn.Module):
    """A wide depthwise convolution and a pointwise network (Liu et al., ConvNeXt, CVPR 2022)."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.depthwise = nn.Conv2d(channels, channels, 7, padding=3, groups=channels)
        self.norm = LayerNorm(channels)
        self.expand = Pointwise(channels, 4 * channels)
        self.reduce = Pointwise(4 * channels, channels)
        self.scale = nn.Parameter(torch.full((1, channels, 1, 1), 1e-6))

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        change = self.reduce(functional.gelu(self.expand(self.norm(self.depthwise(x)))))
        changed: Tensor = x + self.scale * change
        return changed


class LogResidual(Network):
    """Predicts the logarithm of the speckle."""

    def __init__(self, settings: LogResidualSettings) -> None:
        super().__init__(stride=1)
        self.settings = settings
        self.layers = nn.Sequential(
            nn.Conv2d(1, settings.width, 3, padding=1),
            *(WideBlock(settings.width) for _ in range(settings.blocks)),
            nn.Conv2d(settings.width, 1, 3, padding=1),
        )

    def restore(self, noisy: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same."""
        logarithm = torch.log(noisy.clamp(_FLOOR, 1))
        return torch.exp(logarithm - self.layers(logarithm))

    def own_loss(self, noisy: Tensor, progress: float) -> Tensor:
        """Scalar, of noisy images (N, 1, H, W) alone.  progress: of the training, 0 to 1."""
        noisy = noisy.float().clamp(_FLOOR, 1)
        denoised = self.restore(noisy).float().clamp(_FLOOR, 1)
        ratio = (noisy / denoised).clamp(1 / _LARGEST_RATIO, _LARGEST_RATIO)
        residual = torch.log(ratio)

        mean = residual.mean(dim=(2, 3)).abs().mean()
        variance = (residual.var(dim=(2, 3)) - self.settings.variance).abs().mean()
        guide = torch.log(median_of(noisy) + _FLOOR)
        distance = (torch.log(denoised) - guide).abs().mean()
        guided = self.settings.median * min(1.0, progress / _GUIDED)
        return (
            self.settings.statistics * (mean + variance)
            + self.settings.structure * structure_of(residual, denoised)
            + guided * distance
        )


def structure_of(residual: Tensor, denoised: Tensor) -> Tensor:
    """Scalar: mean step of the residual to the next pixel, where the image is even."""
    total = residual.new_zeros(())
    for dim in (2, 3):
        step = residual.diff(dim=dim).abs()
        evenness = torch.exp(-denoised.diff(dim=dim).abs() / _EDGE)
        total = total + (step * evenness).mean()
    return total


@torch.no_grad()
def median_of(image: Tensor) -> Tensor:
    """(N, 1, H, W): the median of 5x5 pixels, borders repeated."""
    margin = _MEDIAN_PX // 2
    padded = functional.pad(image, [margin] * 4, mode="replicate")
    windows = padded.unfold(2, _MEDIAN_PX, 1).unfold(3, _MEDIAN_PX, 1)
    return windows.flatten(-2).median(dim=-1).values
