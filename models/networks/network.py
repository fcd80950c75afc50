"""What all denoising networks share: optional inputs, padding to any size, and their cost."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.utils.flop_counter import FlopCounterMode

Step = Callable[[Tensor], Tensor]


class NetworkOutput(NamedTuple):
    """What a network with heads returns for N images; `models.networks` explains it."""

    image: Tensor
    shadow_logits: Tensor
    weight: Tensor


class Network(nn.Module):
    """Base of the networks in `NETWORKS`; the docstring of `models.networks` is the contract."""

    extras: tuple[str, ...] = ()
    has_heads: ClassVar[bool] = False
    wide_grain: float = 1.0
    """See `models.denoise.denoiser`."""
    average_cells: bool = False
    """See `models.denoise.wide_cells`."""

    def __init__(self, stride: int) -> None:
        """stride: images are padded until their sizes divide by it."""
        super().__init__()
        self.stride = stride

    def forward(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, 1, H, W) float in 0..1 -> the same shape."""
        height, width = noisy.shape[-2:]
        return self.restore(padded(noisy, self.stride))[..., :height, :width]

    def restore(self, noisy: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`."""
        raise NotImplementedError

    def without_interference(
        self, noisy: Tensor, extras: Mapping[str, Tensor]
    ) -> tuple[Tensor, Tensor | None]:
        """The image without interference along bearings, and what `BearingHead` states, if any."""
        return noisy, None

    def with_heads(self, noisy: Tensor, **extras: Tensor) -> NetworkOutput:
        """The image with its whole change, not weighed as by `forward`, and the heads' output."""
        raise NotImplementedError


def known_extras(network: Network, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The optional inputs of the network that the batch holds."""
    return {name: batch[name] for name in network.extras if name in batch}


def padded(x: Tensor, stride: int) -> Tensor:
    """(N, C, H, W) with its last row and column repeated until H and W divide by `stride`."""
    height, width = x.shape[-2:]
    pad = (0, -width % stride, 0, -height % stride)
    return functional.pad(x, pad, mode="replicate") if any(pad) else x


def down_and_up(
    x: Tensor,
    encoders: Iterable[Step],
    downs: Iterable[Step],
    middle: Step,
    ups: Iterable[Step],
    decoders: Iterable[Step],
) -> Tensor:
    """(N, C, H, W) through all levels to the coarsest and back, (N, C, H, W), with added skips."""
    skips = []
    for blocks, down in zip(encoders, downs, strict=True):
        x = blocks(x)
        skips.append(x)
        x = down(x)
    x = middle(x)
    for up, blocks in zip(ups, decoders, strict=True):
        x = blocks(up(x).add_(skips.pop()))
    return x


class LayerNorm(nn.Module):
    """Normalises the channels of every pixel, (N, C, H, W) (Ba et al. 2016)."""

    def __init__(self, channels: int, bias: bool = True) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(channels, eps=1e-6, bias=bias)

    def forward(self, x: Tensor) -> Tensor:
        """The denoised images, of the same shape."""
        # In channels-last memory both permutations are free.
        normed: Tensor = self.norm(x.permute(0, 2, 3, 1))
        return normed.permute(0, 3, 1, 2)


class Pointwise(nn.Conv2d):
    """A 1x1 convolution, computed as a matrix product.

    torch takes a path several times slower for some 1x1 convolutions on a CPU.
    """

    def __init__(self, channels: int, out: int, bias: bool = True) -> None:
        super().__init__(channels, out, 1, bias=bias)

    def forward(self, x: Tensor) -> Tensor:
        """(N, 1, H, W) -> (N, out, H, W), in channels-last memory."""
        product = functional.linear(x.permute(0, 2, 3, 1), self.weight.flatten(1), self.bias)
        return product.permute(0, 3, 1, 2)


def count_macs(network: Network, size_px: int) -> int:
    """Multiply-accumulates of convolutions and matrix products for one square image.

    Without its optional inputs.  Nothing is computed where it is on torch's `meta` device.
    """
    image = torch.rand(1, 1, size_px, size_px, device=next(network.parameters()).device)
    with FlopCounterMode(display=False) as counter, torch.inference_mode():
        network(image)
    # torch counts two floating-point operations a multiply-accumulate.
    return int(counter.get_total_flops()) // 2
