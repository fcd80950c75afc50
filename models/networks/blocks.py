"""Parts that several networks are built of; all begin as the identity."""

from __future__ import annotations

from typing import TypeVar

from torch import Tensor, nn
from torch.nn import functional

Layer = TypeVar("Layer", nn.Linear, nn.Conv1d, nn.Conv2d)


def zeroed(layer: Layer) -> Layer:
    """The layer with weights that give nothing before anything is learned."""
    for weights in layer.parameters():
        nn.init.zeros_(weights)
    return layer


class ResidualBlock(nn.Module):
    """Two convolutions, added to what came in; it starts as the identity."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(channels, channels, 3, padding=1)
        self.second = zeroed(nn.Conv2d(channels, channels, 3, padding=1))

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        changed: Tensor = self.second(functional.relu(self.first(x), inplace=True))
        return changed.add_(x)


def residual_blocks(channels: int, count: int) -> nn.Sequential:
    """A chain of this many residual blocks."""
    return nn.Sequential(*(ResidualBlock(channels) for _ in range(count)))
