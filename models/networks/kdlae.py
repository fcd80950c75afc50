"""A student in three dimensions that sees several pictures of a scene, after KDLAE (2026).

The authors of the SimNFND paper followed it with KDLAE: a teacher as large as Restormer whose
denoising rate can be controlled, and a 3-D student over seven frames.  Neither its paper nor its
code was at hand, so this is written from that one sentence.  Chosen here: the shape and the sizes
of the student (a U of 3-D convolutions that use up the frames on the way down, and a plain decoder
of the one that is left), that it changes the frame in the middle, that frames which are not there
repeat the last one at hand, and the rate: the part of its change that a picture gets, so that 1
removes all and 0 nothing, as `simnfnd denoise --strength` has it.  The teacher is any network that
takes one picture (`train.teacher`, of conf/models.yaml).
"""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn

from ...factory.settings import STRICT
from .network import Network
from .unet import ResidualBlock, residual_blocks

_DEPTH = 3
"""Frames that a 3-D convolution sees at once."""


@dataclass(frozen=True, config=STRICT)
class KDLAESettings:
    """Keys of conf/model/kdlae.yaml.

    frames: pictures of a scene that it sees at once, odd.
    widths: channels at each resolution, from full to coarse.
    blocks: residual blocks at each resolution, on the way down (but for the full one) and again on
        the way up.
    channels: of the images; colours are denoised one by one.
    """

    kind: Literal["kdlae"]
    frames: Annotated[int, Field(ge=1, le=31)]
    widths: tuple[Annotated[int, Field(ge=1, le=512)], ...]
    blocks: Annotated[int, Field(ge=1, le=16)]
    channels: Literal[1] = 1

    def __post_init__(self) -> None:
        if self.frames % 2 == 0:
            raise ValueError("frames must be odd: a picture and as many before it as after it")
        if len(self.widths) < 2:
            raise ValueError("widths must name two resolutions or more")


def frame_block(channels: int, depth: int) -> ResidualBlock:
    """One whose convolutions see `depth` frames."""

    def convolution() -> nn.Conv3d:
        return nn.Conv3d(channels, channels, (depth, 3, 3), padding=(depth // 2, 1, 1))

    return ResidualBlock(convolution(), convolution())


class FrameLevel(nn.Module):
    """One resolution of the way down: two frames fewer, blocks, and all that are left in one.

    before, after: channels.  frames: that come in.  halve: the resolution first.
    left: frames that go out.
    """

    def __init__(self, before: int, after: int, frames: int, blocks: int, halve: bool) -> None:
        super().__init__()
        depth = min(_DEPTH, frames)
        self.left = frames - depth + 1
        down = nn.Conv3d(before, after, (1, 2, 2), stride=(1, 2, 2)) if halve else nn.Identity()
        reduced = nn.Conv3d(after if halve else before, after, (depth, 3, 3), padding=(0, 1, 1))
        inner = _DEPTH if self.left > 1 else 1
        self.frames = nn.Sequential(
            down, reduced, nn.ReLU(), *(frame_block(after, inner) for _ in range(blocks))
        )
        self.joined = nn.Conv3d(after, after, (self.left, 1, 1))

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """(N, before, frames, H, W) -> (N, after, left, H', W') and (N, after, H', W')."""
        x = self.frames(x)
        # The ONNX exporter loses the rank of `squeeze`.
        return x, self.joined(x)[:, :, 0]


class KDLAE(Network):
    """Several pictures of a scene in, what to add to the one in the middle out."""

    extras = ("looks", "rate")

    def __init__(self, settings: KDLAESettings) -> None:
        widths, blocks = settings.widths, settings.blocks
        super().__init__(settings.channels, stride=2 ** (len(widths) - 1))
        self.looks = settings.frames
        self.levels = nn.ModuleList()
        before, left = 1, settings.frames
        for number, width in enumerate(widths):
            # At full resolution several frames would cost half of everything.
            own = blocks if number else 0
            level = FrameLevel(before, width, left, own, halve=number > 0)
            self.levels.append(level)
            before, left = width, level.left
        self.ups, self.decoders = nn.ModuleList(), nn.ModuleList()
        for coarse, fine in zip(widths[:0:-1], widths[-2::-1], strict=True):
            self.ups.append(nn.ConvTranspose2d(coarse, fine, 2, stride=2))
            self.decoders.append(residual_blocks(fine, blocks))
        self.outro = nn.Conv2d(widths[0], 1, 3, padding=1)

    def restore(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """(N, 1, H, W) -> the same; H and W divide by `stride`.

        extras: `looks` (N, T, H, W) and `rate` (N, 1), see `models.networks`.
        """
        frames = noisy.expand(-1, self.looks, -1, -1)
        if "looks" in extras:
            frames = frames_of(extras["looks"], self.looks)
        x, skips = frames[:, None], []
        for level in self.levels:
            x, joined = level(x)
            skips.append(joined)
        found = skips.pop()
        for up, blocks in zip(self.ups, self.decoders, strict=True):
            found = blocks(up(found) + skips.pop())
        change: Tensor = self.outro(found)
        if "rate" in extras:
            change = extras["rate"][:, :, None, None] * change
        return noisy + change


def frames_of(looks: Tensor, count: int) -> Tensor:
    """(N, T, H, W) -> (N, count, H, W) around the one in the middle; the ends are repeated.

    Raises ValueError where T is even: then none is in the middle.
    """
    there = looks.shape[1]
    if there % 2 == 0:
        raise ValueError(f"looks hold {there} pictures; expected an odd number, its own amid them")
    if there == count:
        return looks
    first = there // 2 - count // 2
    places = [min(max(place, 0), there - 1) for place in range(first, first + count)]
    return torch.stack([looks[:, place] for place in places], dim=1)
