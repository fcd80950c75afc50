"""SonarNet, a light network of this project, built around what a sonar picture is.

- It works on a polar grid: where the geometry of a fan picture is known, the picture is resampled
  to range and bearing, and the network's correction is resampled back to the fan's pixels
  (`networks.polar`).  The noisy picture itself is never resampled, so no detail is lost.
- Range, bearing and the insonified sector of every cell are inputs, and what is to be removed is
  told, too: six numbers that scale and shift the features of every level (FiLM, Perez et al. 2018).
- Means along whole beams and arcs are part of the features (`networks.lines`).
- With `frames` it gets a plane that says how many frames were averaged in each pixel; it scales and
  shifts the features of every level pixel by pixel, and changes nothing for a single frame.
- A second head predicts shadow (black in the clean picture); the picture is multiplied by one minus
  that.
- A third (`networks.blend_head`) weighs the change of the whole picture, which falls to nothing
  where hardly anything is wrong with it.
- Plain 3x3 convolutions from half resolution down: they are what a CPU does fastest.

Without geometry it works on the picture as it is; in training the geometry is withheld now and then
(`forget`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn
from torch.nn import functional

from ...factory.imaging.effect import ARTEFACTS
from ...factory.settings import STRICT
from ..removal import DEFAULT, vector
from .blend_head import BlendHead
from .lines import GridLines, LineContext, Lines, MapLines
from .network import (
    Network,
    NetworkOutput,
    Step,
    down_and_up,
    padded,
    residual_blocks,
    u_shape,
)
from .polar import polar_grid

_MAPS = ("range_fraction", "azimuth_rad", "sector")
_TOLD = 32  # features of what is to be removed
_FRAMES = 4.0  # log2 of the most frames that are averaged
_HALVED = -math.log(2) / 2  # noise falls by the root of two with twice as many frames
# Logit of shadow before anything is learned, and outside the sector.
_FIRST, _OUTSIDE = -2.0, -10.0


@dataclass(frozen=True, config=STRICT)
class SonarNetSettings:
    """Keys of conf/model/sonarnet.yaml.

    widths: channels at half resolution and at each coarser one.
    blocks: residual blocks at each of these; but for the coarsest, again on the way up.
    polar: whether fan pictures of known geometry are processed on a polar grid.
    lines: whether features get the means along whole beams and arcs.
    mask: whether the second head gates the picture with the shadow that it predicts.
    forget: part of the training steps in which the network gets no geometry.
    wide_grain: correlation of neighbouring pixels' grain from which on `simnfnd denoise` denoises
        a picture at half its size first (`models.denoise.denoiser`); 1: never; not in training, so
        trained weights may change it.
    told: whether the network is told what to remove; else it always removes the same.
    frames: whether it gets the number of frames averaged in each pixel; not with `polar`.
    """

    kind: Literal["sonarnet"]
    widths: tuple[Annotated[int, Field(ge=1, le=1024)], ...]
    blocks: tuple[Annotated[int, Field(ge=0, le=64)], ...]
    polar: bool
    lines: bool
    mask: bool
    forget: Annotated[float, Field(ge=0, le=1)]
    wide_grain: Annotated[float, Field(ge=0, le=1)] = 1.0
    told: bool = True
    frames: bool = False

    def __post_init__(self) -> None:
        if self.frames and self.polar:
            raise ValueError("frames: is not possible with polar=true; set polar=false")
        if not self.widths or len(self.widths) != len(self.blocks):
            raise ValueError(
                f"widths has {len(self.widths)} resolutions and blocks {len(self.blocks)}; "
                "give one or more, and as many of each"
            )


class SonarNet(Network):
    """Predicts what to add to the noisy picture, where it shows shadow, and how much of it."""

    has_heads: ClassVar[bool] = True

    def __init__(self, settings: SonarNetSettings) -> None:
        # Padding happens on the polar grid, which has a size of its own.
        super().__init__(stride=1)
        self.settings = settings
        self.wide_grain = settings.wide_grain
        # Whether known geometries are those of fans; None: seen from the maps.
        self.fan: bool | None = None
        widths, blocks = settings.widths, settings.blocks
        self.core_stride = 2 ** len(widths)
        planes = 1 + len(_MAPS) + settings.frames
        self.intro = nn.Conv2d(4 * planes, widths[0], 3, padding=1)
        told = ("remove",) if settings.told else ()
        self.extras = (*_MAPS, *told, *(("frames",) if settings.frames else ()))
        if settings.told:
            self.told = nn.Sequential(nn.Linear(len(ARTEFACTS), _TOLD), nn.ReLU())
            self.films = nn.ModuleList(_film(width) for width in widths)
        if settings.frames:
            self.frames = nn.ModuleList(_frames_film(width) for width in widths)
        self.lines = LineContext(widths[0]) if settings.lines else None
        self.encoders, self.downs, self.ups, self.decoders = u_shape(widths, blocks)
        self.middle = residual_blocks(widths[-1], blocks[-1])
        self.outro = nn.Conv2d(widths[0], 4 * 2, 3, padding=1)
        nn.init.zeros_(self.outro.weight)
        assert self.outro.bias is not None
        nn.init.constant_(self.outro.bias[:4], 0.0)
        nn.init.constant_(self.outro.bias[4:], _FIRST)
        self.blend = BlendHead(widths[0])

    def restore_with_heads(self, noisy: Tensor, **extras: Tensor) -> NetworkOutput:
        """Picture (N, 1, H, W), logits (N, 1, H, W) of shadow, (N,) weight, for any H and W.

        Geometry counts only where `range_fraction` and `azimuth_rad` are both there; without
        `sector` everything is insonified.  remove: (N, 6), 1 for each artefact to remove (see
        `imaging.contract.ARTEFACTS`); without it the usual ones.  frames: (N, 1, H, W), how many
        frames were averaged, as of `removal.averaged`; without it 0, a single frame.
        """
        remove, frames = extras.get("remove"), extras.get("frames")
        if remove is None:
            usual = torch.from_numpy(vector(DEFAULT)).to(noisy)
            remove = usual.expand(noisy.shape[0], -1)
        if frames is None and self.settings.frames:
            frames = torch.zeros_like(noisy)
        has_geometry = "range_fraction" in extras and "azimuth_rad" in extras
        if self.training and has_geometry and self.settings.forget:
            has_geometry = bool(torch.rand(()) >= self.settings.forget)
        if not has_geometry:
            change, logits, weight = self.core(remove, frames, GridLines(), noisy, *_unknown(noisy))
            return NetworkOutput(self.gated(noisy + change, logits), logits, weight)
        range_fraction, azimuth_rad = extras["range_fraction"], extras["azimuth_rad"]
        sector = extras.get("sector", torch.ones_like(noisy))
        grid = None
        if self.settings.polar:
            grid = polar_grid(range_fraction, azimuth_rad, sector, fan=self.fan)
        if grid is None:
            lines = self._lines(azimuth_rad, range_fraction, sector)
            maps = _known(range_fraction, azimuth_rad, sector)
            change, logits, weight = self.core(remove, frames, lines, noisy, *maps)
        else:
            polar = grid.polar(torch.cat([noisy, sector], dim=1))
            maps = _known(grid.range_fraction, grid.azimuth_rad, polar[:, 1:])
            *cells, weight = self.core(remove, None, GridLines(), polar[:, :1], *maps)
            change, logits = grid.fan(torch.cat(cells, dim=1)).chunk(2, dim=1)
        # Outside the sector there is nothing to denoise and no shadow.
        inside = sector > 0
        change = change.masked_fill(~inside, 0.0)
        image = self.gated(noisy + change, logits)
        image = torch.where(inside, image, noisy)
        return NetworkOutput(image, logits.masked_fill(~inside, _OUTSIDE), weight)

    def _lines(self, azimuth_rad: Tensor, range_fraction: Tensor, sector: Tensor) -> Lines:
        """The beams and arcs of features at half resolution."""
        planes = [padded(x, self.core_stride) for x in (azimuth_rad, range_fraction, sector)]
        height, width = planes[0].shape[-2:]
        return MapLines.of(planes[0], planes[1], planes[2], (height // 2, width // 2))

    def gated(self, image: Tensor, logits: Tensor) -> Tensor:
        """The picture, darker where the logits say shadow; (N, 1, H, W) both."""
        return image * torch.sigmoid(-logits) if self.settings.mask else image

    def core(
        self, remove: Tensor, frames: Tensor | None, lines: Lines, *planes: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What to add and logits of shadow, (N, 1, H, W) as the planes; the weight, (N,).

        planes: the picture and its maps as of `_known` or `_unknown`.  frames: as of
        `restore_with_heads`.  lines: beams and arcs of the features at half resolution.
        """
        height, width = planes[0].shape[-2:]
        inputs = [padded(plane, self.core_stride) for plane in planes]
        levels = None
        if frames is not None:
            frames = padded(frames, self.core_stride)
            inputs.append(frames / _FRAMES)
            levels = _frames_levels(frames, len(self.settings.widths))
        x = self.intro(functional.pixel_unshuffle(torch.cat(inputs, dim=1), 2))
        if self.lines is not None:
            x = self.lines(x, lines)
        *encoders, middle = self._told_steps(remove, levels)
        x = down_and_up(x, encoders, self.downs, middle, self.ups, self.decoders)
        heads = functional.pixel_shuffle(self.outro(x), 2)[..., :height, :width]
        noisy, change, logits = planes[0], heads[:, :1], heads[:, 1:]
        # The last plane is the sector's complement, or -1 where it is unknown.
        sector = 1 - planes[-1].clamp_min(0)
        denoised = self.gated(noisy + change, logits)
        return change, logits, self.blend(x, noisy, denoised - noisy, sector)

    def _told_steps(self, remove: Tensor, levels: Sequence[Tensor] | None) -> list[Step]:
        """The blocks of every level on the way down, with what scales and shifts their features.

        levels: how many frames were averaged, at the resolution of each level.
        """
        steps: list[Step] = [*self.encoders, self.middle]
        films: list[Tensor] = []
        if self.settings.told:
            told = self.told(remove)
            films = [film(told)[:, :, None, None] for film in self.films]
        if levels is not None:
            found = [film(level) for film, level in zip(self.frames, levels, strict=True)]
            films = [one + more for one, more in zip(films, found, strict=True)] if films else found
        return [_after(*both) for both in zip(films, steps, strict=True)] if films else steps


def _film(width: int) -> nn.Linear:
    """Scales and shifts of `width` channels; none before anything is learned."""
    film = nn.Linear(_TOLD, 2 * width)
    nn.init.zeros_(film.weight)
    nn.init.zeros_(film.bias)
    return film


def _frames_film(width: int) -> nn.Conv2d:
    """Scales and shifts of `width` channels from the planes of `_frames_levels`; none at first."""
    film = nn.Conv2d(2, 2 * width, 1, bias=False)
    nn.init.zeros_(film.weight)
    return film


def _frames_levels(frames: Tensor, count: int) -> list[Tensor]:
    """log2 of the number of frames and what their noise has less, at half resolution and coarser.

    frames: (N, 1, H, W) log2.  Both planes are 0 for a single frame.
    """
    planes, levels = torch.cat([frames / _FRAMES, torch.exp(frames * _HALVED) - 1], dim=1), []
    for _ in range(count):
        planes = functional.avg_pool2d(planes, 2)
        levels.append(planes)
    return levels


def _after(film: Tensor, blocks: Step) -> Step:
    """The blocks on features that were scaled and shifted before."""
    scale, shift = film.chunk(2, dim=1)
    return lambda x: blocks(torch.addcmul(shift.to(x.dtype), x, (1 + scale).to(x.dtype)))


def _known(range_fraction: Tensor, azimuth_rad: Tensor, sector: Tensor) -> tuple[Tensor, ...]:
    """The maps as the first layer gets them, centred: otherwise they drown the picture."""
    return 2 * range_fraction - 1, azimuth_rad, 1 - sector


def _unknown(noisy: Tensor) -> tuple[Tensor, ...]:
    """The same for unknown geometry; the last value occurs in no known one."""
    nothing = torch.zeros_like(noisy)
    return nothing, nothing, nothing - 1
