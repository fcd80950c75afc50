"""What all denoising networks share: any image size, one or three channels, optional inputs."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from typing import ClassVar, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.utils.flop_counter import FlopCounterMode

Step = Callable[[Tensor], Tensor]


class NetworkOutput(NamedTuple):
    """What a network with heads returns for N pictures.

    image: (N, C, H, W), with the whole change.  shadow_logits: (N, 1, H, W), positive where it sees
    shadow.  weight: (N,), the part of the change that the picture should get, 0 to 1.
    """

    image: Tensor
    shadow_logits: Tensor
    weight: Tensor


class Network(nn.Module):
    """Base of the networks in `models.NETWORKS`; the docstring of `models` is the contract.

    A network sets `stride` (sizes must divide by it) and implements `restore`, or
    `restore_with_heads` if it has heads, of pictures of one channel.
    """

    extras: tuple[str, ...] = ()
    has_heads: ClassVar[bool] = False
    wide_grain: float = 1.0
    """See `models.denoise.denoiser`."""

    def __init__(self, stride: int) -> None:
        super().__init__()
        self.stride = stride

    def restore(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`; extras as given."""
        output = self.restore_with_heads(noisy, **extras)
        part = output.weight[:, None, None, None].to(noisy.dtype)
        return noisy + part * (output.image - noisy)

    def restore_with_heads(self, noisy: Tensor, **extras: Tensor) -> NetworkOutput:
        """Like `restore`, with the output of the heads."""
        raise NotImplementedError

    def forward(self, noisy: Tensor, **extras: Tensor | None) -> Tensor:
        """(N, C, H, W) float in 0..1 -> the same shape, C 1 or 3.

        Raises ValueError for another shape and TypeError for an extra that it does not use.
        """
        image, known = self._prepared(noisy, extras)
        return self._restored(self.restore(image, **known), noisy)

    def with_heads(self, noisy: Tensor, **extras: Tensor | None) -> NetworkOutput:
        """The image with its whole change, not weighed as by `forward`, and the heads' output.

        Raises ValueError and TypeError as `forward` does, and TypeError without heads.
        """
        if not self.has_heads:
            raise TypeError(f"{type(self).__name__} has no heads")
        image, known = self._prepared(noisy, extras)
        output = self.restore_with_heads(image, **known)
        height, width = noisy.shape[-2:]
        logits = output.shadow_logits[..., :height, :width].reshape(
            noisy.shape[0], -1, height, width
        )
        return NetworkOutput(
            self._restored(output.image, noisy),
            logits.mean(dim=1, keepdim=True),
            output.weight.reshape(noisy.shape[0], -1).mean(dim=1),
        )

    def _prepared(
        self, noisy: Tensor, extras: dict[str, Tensor | None]
    ) -> tuple[Tensor, dict[str, Tensor]]:
        if noisy.ndim != 4 or noisy.shape[1] not in (1, 3) or 0 in noisy.shape:
            raise ValueError(f"images have shape {tuple(noisy.shape)}; expected (N, 1 or 3, H, W)")
        unknown = sorted(set(extras) - set(self.extras))
        if unknown:
            raise TypeError(f"{type(self).__name__} does not use {', '.join(unknown)}")
        known = {name: value for name, value in extras.items() if value is not None}
        channels = noisy.shape[1]
        if channels > 1:
            # Each channel is an image of its own.
            noisy = noisy.reshape(-1, 1, *noisy.shape[-2:])
            known = {name: x.repeat_interleave(channels, dim=0) for name, x in known.items()}
        maps = {name: padded(x, self.stride) if x.ndim == 4 else x for name, x in known.items()}
        return padded(noisy, self.stride), maps

    def _restored(self, image: Tensor, noisy: Tensor) -> Tensor:
        height, width = noisy.shape[-2:]
        return image[..., :height, :width].reshape(noisy.shape)


def known_extras(network: Network, batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The optional inputs of the network that the batch holds."""
    return {name: batch[name] for name in network.extras if name in batch}


def padded(x: Tensor, stride: int) -> Tensor:
    """(N, C, H, W) lengthened at right and bottom until H and W divide by `stride`.

    The last row and column are repeated.
    """
    height, width = x.shape[-2:]
    pad = (0, -width % stride, 0, -height % stride)
    return functional.pad(x, pad, mode="replicate") if any(pad) else x


def u_shape(
    widths: Sequence[int], blocks: Sequence[int]
) -> tuple[nn.ModuleList, nn.ModuleList, nn.ModuleList, nn.ModuleList]:
    """Encoders, halvings, doublings and decoders between resolutions of these widths.

    blocks: residual blocks at each resolution.  The coarsest has none here.
    """
    encoders, downs, ups, decoders = (nn.ModuleList() for _ in range(4))
    for (fine, coarse), count in zip(pairwise(widths), blocks, strict=False):
        encoders.append(residual_blocks(fine, count))
        downs.append(nn.Conv2d(fine, coarse, 2, stride=2))
        ups.insert(0, nn.ConvTranspose2d(coarse, fine, 2, stride=2))
        decoders.insert(0, residual_blocks(fine, count))
    return encoders, downs, ups, decoders


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


class ResidualBlock(nn.Module):
    """Two convolutions, added to what came in; it starts as the identity."""

    def __init__(self, first: nn.Conv2d, second: nn.Conv2d) -> None:
        super().__init__()
        self.first, self.second = first, second
        nn.init.zeros_(self.second.weight)
        assert self.second.bias is not None
        nn.init.zeros_(self.second.bias)

    def forward(self, x: Tensor) -> Tensor:
        """(N, C, H, W) -> the same shape."""
        changed: Tensor = self.second(functional.relu(self.first(x), inplace=True))
        return changed.add_(x)


def residual_blocks(channels: int, count: int) -> nn.Sequential:
    """So many of them of 3x3, one after another."""

    def convolution() -> nn.Conv2d:
        return nn.Conv2d(channels, channels, 3, padding=1)

    return nn.Sequential(*(ResidualBlock(convolution(), convolution()) for _ in range(count)))


class LayerNorm(nn.Module):
    """Normalises the channels of every pixel, (N, C, H, W) (Ba et al. 2016)."""

    def __init__(self, channels: int, bias: bool = True) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(channels, eps=1e-6, bias=bias)

    def forward(self, x: Tensor) -> Tensor:
        """Same shape."""
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


def halves(x: Tensor) -> tuple[Tensor, Tensor]:
    """The first and the second half of the channels, (N, 2C, H, W) -> 2 x (N, C, H, W)."""
    first, second = torch.chunk(x, 2, dim=1)
    return first, second


def count_macs(network: Network, size_px: int) -> int:
    """Multiply-accumulates of convolutions and matrix products for one square image.

    Of the network in use, where that differs from training, and without its optional inputs.
    Nothing is computed where the network is on torch's `meta` device.
    """
    image = torch.rand(1, 1, size_px, size_px, device=next(network.parameters()).device)
    was_training = network.training
    network.eval()
    try:
        # Attention as its two products, which are what torch counts.
        counter = FlopCounterMode(display=False)
        with counter, sdpa_kernel(SDPBackend.MATH), torch.inference_mode():
            network(image)
    finally:
        network.train(was_training)
    # torch counts two floating-point operations a multiply-accumulate.
    return int(counter.get_total_flops()) // 2
