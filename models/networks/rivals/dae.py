"""A convolutional denoising autoencoder, after the abstract.

Kim, Song, Yu: Denoising auto-encoder based image enhancement for high resolution sonar image, IEEE
Underwater Technology 2017: convolutions and pooling down to a code, convolutions and upsampling
back, and no way around the code.  The paper's table of layers was not at hand; the sizes are ours,
and the output is linear instead of a sigmoid.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from ....factory.common.settings import STRICT
from ..network import Network


@dataclass(frozen=True, config=STRICT)
class DAESettings:
    """Keys of conf/model/dae.yaml, which explains them."""

    kind: Literal["dae"]
    widths: tuple[Annotated[int, Field(ge=1, le=1024)], ...]

    def __post_init__(self) -> None:
        if not self.widths:
            raise ValueError("widths must name one layer or more")


class DAE(Network):
    """The image drawn anew from its code; fine detail is what it loses."""

    def __init__(self, settings: DAESettings) -> None:
        super().__init__(stride=2 ** len(settings.widths))
        layers: list[nn.Module] = []
        channels = 1
        for width in settings.widths:
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(), nn.MaxPool2d(2)]
            channels = width
        for width in reversed(settings.widths):
            layers += [nn.Conv2d(channels, width, 3, padding=1), nn.ReLU(), nn.Upsample(None, 2)]
            channels = width
        self.layers = nn.Sequential(*layers, nn.Conv2d(channels, 1, 3, padding=1))

    def restore(self, noisy: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`."""
        restored: Tensor = self.layers(noisy)
        return restored
