"""SonarNet, a light network of this project, built around what a sonar image is.

- It works on a polar grid: where the geometry of a fan image is known, the image is resampled
  to range and bearing, and the network's correction is resampled back to the fan's pixels
  (`FanSampling`).  The noisy image itself is never resampled, so no detail is lost.
- Range, bearing and the insonified sector of every cell are inputs.  What is to be removed scales
  and shifts the features of every level (FiLM, Perez et al. 2018), and so does, pixel by pixel, how
  many frames were averaged, which changes nothing for a single frame.
- A head that sees whole bearings says what interference lies along them, which is subtracted first
  (`BearingHead`).
- Means along whole beams and arcs are part of the features (`LineContext`).
- A second head predicts shadow, in which the image is black; a third (`BlendHead`) weighs the
  change of the whole image.
- Plain 3x3 convolutions from half resolution down: they are what a CPU does fastest.

Without geometry it works on the image as it is; in training the geometry is withheld now and then
(`forget`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, cast

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass as settings_class
from torch import Tensor, nn
from torch.nn import functional

from ...factory.common.settings import STRICT
from ...factory.simulation.imaging.artefacts import ARTEFACTS
from . import BEARING_INPUTS, DEFAULT, GEOMETRY, vector
from .bearings import BearingHead, at_pixels, remaining_share
from .blend_head import BlendHead
from .blocks import residual_blocks, zeroed
from .folded import (
    LineTables,
    first_features,
    scaled_and_shifted,
    shuffled,
    unshuffled_conv,
)
from .line_context import GridLines, LineContext, Lines, MapLines
from .network import Network, NetworkOutput, Step, down_and_up, padded
from .polar_grid import FanSampling, polar_grid, sampled

_TOLD = 32  # features of what is to be removed
_FRAMES = 4.0  # log2 of the most frames that are averaged
_HALVED = -math.log(2) / 2  # noise falls by the root of two with twice as many frames
# Logit of shadow before anything is learned, and outside the sector.
_FIRST_LOGIT = -2.0
_OUTSIDE = -10.0


@settings_class(frozen=True, config=STRICT)
class SonarNetSettings:
    """Keys of conf/model/sonarnet.yaml, which explains them."""

    kind: Literal["sonarnet"]
    widths: tuple[Annotated[int, Field(ge=1, le=1024)], ...]
    blocks: tuple[Annotated[int, Field(ge=0, le=64)], ...]
    polar: bool
    lines: bool
    mask: bool
    forget: Annotated[float, Field(ge=0, le=1)]
    wide_grain: Annotated[float, Field(ge=0, le=1)] = 1.0
    average_cells: bool = False
    told: bool = True
    frames: bool = False
    bearings: bool = False

    def __post_init__(self) -> None:
        if self.average_cells and not self.polar:
            raise ValueError("average_cells: needs the polar grid; set polar=true")
        if self.frames and self.polar:
            raise ValueError("frames: is not possible with polar=true; set polar=false")
        if not self.widths or len(self.widths) != len(self.blocks):
            raise ValueError(
                f"widths has {len(self.widths)} resolutions and blocks {len(self.blocks)}; "
                "give one or more, and as many of each"
            )


class CoreOutput(NamedTuple):
    """What the core of a SonarNet computes for N images.

    change: what to add, (N, 1, H, W).  shadow_logits: (N, 1, H, W).  weight: the share of the
    change to apply, (N,).
    """

    change: Tensor
    shadow_logits: Tensor
    weight: Tensor


class SonarNet(Network):
    """Predicts what to add to the noisy image, where it shows shadow, and how much of it."""

    has_heads: ClassVar[bool] = True

    def __init__(self, settings: SonarNetSettings) -> None:
        # Padding happens on the polar grid, which has a size of its own.
        super().__init__(stride=1)
        self.settings = settings
        self.wide_grain = settings.wide_grain
        self.average_cells = settings.average_cells
        # Whether known geometries are those of fans; None: seen from the maps.
        self.fan: bool | None = None
        # Whether layers are computed as is fastest in an exported graph; see `folded`.
        self.folds = False
        widths = settings.widths
        blocks = settings.blocks
        self.core_stride = 2 ** len(widths)
        planes = 1 + len(GEOMETRY) + settings.frames
        self.intro = nn.Conv2d(4 * planes, widths[0], 3, padding=1)
        remove_inputs = ("remove",) if settings.told else ()
        # What is always forgotten is no input.
        maps = GEOMETRY if settings.forget < 1 else ()
        views = BEARING_INPUTS if settings.bearings and settings.forget < 1 else ()
        frames_inputs = ("frames",) if settings.frames else ()
        self.extras = (*maps, *remove_inputs, *frames_inputs, *views)
        self.bearings = BearingHead() if settings.bearings else None
        if settings.told:
            self.told = nn.Sequential(nn.Linear(len(ARTEFACTS), _TOLD), nn.ReLU())
            self.films = nn.ModuleList(zeroed(nn.Linear(_TOLD, 2 * width)) for width in widths)
        if settings.frames:
            self.frames = nn.ModuleList(
                zeroed(nn.Conv2d(2, 2 * width, 1, bias=False)) for width in widths
            )
        self.lines = LineContext(widths[0]) if settings.lines else None
        self.encoders, self.downs, self.ups, self.decoders = (nn.ModuleList() for _ in range(4))
        for (fine, coarse), count in zip(pairwise(widths), blocks, strict=False):
            self.encoders.append(residual_blocks(fine, count))
            self.downs.append(nn.Conv2d(fine, coarse, 2, stride=2))
            self.ups.insert(0, nn.ConvTranspose2d(coarse, fine, 2, stride=2))
            self.decoders.insert(0, residual_blocks(fine, count))
        self.middle = residual_blocks(widths[-1], blocks[-1])
        self.outro = zeroed(nn.Conv2d(widths[0], 4 * 2, 3, padding=1))
        nn.init.constant_(cast(Tensor, self.outro.bias)[4:], _FIRST_LOGIT)
        self.blend = BlendHead(widths[0])

    def forward(self, noisy: Tensor, **extras: Tensor) -> Tensor:
        """The image with the part of its change that the blend head gives it, (N, 1, H, W)."""
        noisy, _ = self.without_interference(noisy, extras)
        output = self.with_heads(noisy, **extras)
        part = output.weight[:, None, None, None].to(noisy.dtype)
        return noisy + part * (output.image - noisy)

    def without_interference(
        self, noisy: Tensor, extras: Mapping[str, Tensor]
    ) -> tuple[Tensor, Tensor | None]:
        """See `Network`; needs the maps, `bearings` and `bearing_sector`."""
        needed = {"range_fraction", "azimuth_rad", "bearings", "bearing_sector"}
        if self.bearings is None or not needed <= extras.keys():
            return noisy, None
        limits = extras["bearing_sector"]
        views = extras["bearings"]
        crops = limits.shape[0] // views.shape[0]
        width_rad = (limits[::crops, 3:] - limits[::crops, 2:3]).abs()
        nodes = self.bearings(views, width_rad)
        shares = remaining_share(nodes, views).repeat_interleave(crops, dim=0)
        share = at_pixels(shares, limits, extras["range_fraction"], extras["azimuth_rad"])
        sector = extras.get("sector", torch.ones_like(noisy))
        return torch.where(sector > 0, share * noisy, noisy), nodes

    def with_heads(self, noisy: Tensor, **extras: Tensor) -> NetworkOutput:
        """See `models.networks`; for any H and W.

        Geometry counts only where `range_fraction` and `azimuth_rad` are both there; without
        `sector` everything is insonified, without `remove` it is `networks.DEFAULT`.  frames:
        (N, 1, H, W), how many were averaged, as of `networks.averaged`; without it 0, a single one.
        """
        remove = extras.get("remove")
        frames = extras.get("frames")
        if remove is None:
            usual = torch.from_numpy(vector(DEFAULT)).to(noisy)
            remove = usual.repeat(noisy.shape[0], 1)
        if frames is None and self.settings.frames:
            frames = torch.zeros_like(noisy)
        has_geometry = {"range_fraction", "azimuth_rad"} <= extras.keys()
        if self.training and has_geometry and self.settings.forget:
            has_geometry = bool(torch.rand(()) >= self.settings.forget)
        if not has_geometry:
            return self._without_geometry(noisy, remove, frames)
        range_fraction = extras["range_fraction"]
        azimuth_rad = extras["azimuth_rad"]
        sector = extras.get("sector", torch.ones_like(noisy))
        grid = None
        if self.settings.polar:
            grid = polar_grid(range_fraction, azimuth_rad, sector, fan=self.fan)
        if grid is None:
            maps = range_fraction, azimuth_rad, sector
            change, logits, weight = self._on_image(noisy, remove, frames, *maps)
        else:
            change, logits, weight = self._on_polar_grid(noisy, remove, grid, sector)
        # Outside the sector there is nothing to denoise and no shadow.
        outside = sector <= 0
        image = self.gated(noisy + change.masked_fill(outside, 0.0), logits)
        image = torch.where(outside, noisy, image)
        return _output(image, logits.masked_fill(outside, _OUTSIDE), weight)

    def _without_geometry(
        self, noisy: Tensor, remove: Tensor, frames: Tensor | None
    ) -> NetworkOutput:
        core = self.core(remove, frames, GridLines(), noisy, *_unknown(noisy))
        image = self.gated(noisy + core.change, core.shadow_logits)
        return _output(image, core.shadow_logits, core.weight)

    def _on_image(
        self,
        noisy: Tensor,
        remove: Tensor,
        frames: Tensor | None,
        range_fraction: Tensor,
        azimuth_rad: Tensor,
        sector: Tensor,
    ) -> CoreOutput:
        """What the core computes on the image as it is."""
        planes = (padded(x, self.core_stride) for x in (azimuth_rad, range_fraction, sector))
        maps = _known(range_fraction, azimuth_rad, sector)
        return self.core(remove, frames, MapLines.of(*planes), noisy, *maps)

    def _on_polar_grid(
        self, noisy: Tensor, remove: Tensor, grid: FanSampling, sector: Tensor
    ) -> CoreOutput:
        """What the core computes on the polar grid, resampled to the pixels of the fan."""
        polar = sampled(torch.cat([noisy, sector], dim=1), grid.to_polar)
        maps = _known(grid.range_fraction, grid.azimuth_rad, polar[:, 1:])
        core = self.core(remove, None, GridLines(), polar[:, :1], *maps)
        cells = torch.cat([core.change, core.shadow_logits], dim=1)
        change, logits = sampled(cells, grid.to_fan).chunk(2, dim=1)
        return CoreOutput(change, logits, core.weight)

    def gated(self, image: Tensor, logits: Tensor) -> Tensor:
        """The image, darker where the logits say shadow; (N, 1, H, W) both."""
        return image * torch.sigmoid(-logits) if self.settings.mask else image

    def core(
        self,
        remove: Tensor,
        frames: Tensor | None,
        lines: Lines | LineTables,
        *planes: Tensor,
        geometry: Tensor | None = None,
    ) -> CoreOutput:
        """What the network computes on the grid of its inputs, inside and outside the sector.

        planes: the image and its maps as of `_known` or `_unknown`.  frames: as of
        `with_heads`.  lines: beams and arcs of the features at half resolution.
        geometry: of an exported graph, `folded.geometry_features` of the maps, of which `planes`
        then holds the last one only, and `lines` are `LineTables`.
        """
        height, width = planes[0].shape[-2:]
        inputs = [padded(plane, self.core_stride) for plane in planes]
        levels: list[Tensor] = []
        if frames is not None:
            frames = padded(frames, self.core_stride)
            inputs.append(frames / _FRAMES)
            # log2 of their number, and what their noise has less; both are 0 for a single frame.
            level = torch.cat([frames / _FRAMES, torch.exp(frames * _HALVED) - 1], dim=1)
            for _ in self.settings.widths:
                level = functional.avg_pool2d(level, 2)
                levels.append(level)
        if geometry is None:
            stacked = torch.cat(inputs, dim=1)
            if self.folds:
                x = unshuffled_conv(self.intro, stacked)
            else:
                x = self.intro(functional.pixel_unshuffle(stacked, 2))
            if self.lines is not None:
                x = self.lines(x, lines)
        else:
            image = torch.cat([inputs[0], *inputs[2:]], dim=1)
            tables = cast(LineTables, lines)
            x = first_features(self.intro, self.lines, image, geometry, tables)
        *encoders, middle = self._conditioned(remove, levels)
        x = down_and_up(x, encoders, self.downs, middle, self.ups, self.decoders)
        shuffle = shuffled if self.folds else partial(functional.pixel_shuffle, upscale_factor=2)
        heads = shuffle(self.outro(x))[..., :height, :width]
        noisy = planes[0]
        change = heads[:, :1]
        logits = heads[:, 1:]
        sector = _sector(planes[-1])
        denoised = self.gated(noisy + change, logits)
        weight = self.blend(x, noisy, denoised - noisy, sector, folds=self.folds)
        return CoreOutput(change, logits, weight)

    def _conditioned(self, remove: Tensor, levels: list[Tensor]) -> list[Step]:
        """The blocks on the way down, on features scaled and shifted by the condition.

        levels: how many frames were averaged, at the resolution of each level; or none.
        """
        steps: list[Step] = [*self.encoders, self.middle]
        films: list[Tensor] = []
        if self.settings.told:
            condition = self.told(remove)
            films = [film(condition)[:, :, None, None] for film in self.films]
        if levels and self.folds and not films:
            return [
                _after_level(film, level, step)
                for film, level, step in zip(cast(Any, self.frames), levels, steps, strict=True)
            ]
        if levels:
            more = [film(level) for film, level in zip(self.frames, levels, strict=True)]
            films = [a + b for a, b in zip(films, more, strict=True)] if films else more
        return [_after(*both) for both in zip(films, steps, strict=True)] if films else steps


def _output(image: Tensor, logits: Tensor, weight: Tensor) -> NetworkOutput:
    # A mean of one channel: without it gradients are laid out otherwise, and weights round
    # otherwise.
    return NetworkOutput(image, logits.mean(dim=1, keepdim=True), weight)


def _after(film: Tensor, blocks: Step) -> Step:
    """The blocks on features that were scaled and shifted before."""
    scale, shift = film.chunk(2, dim=1)
    return lambda x: blocks(torch.addcmul(shift.to(x.dtype), x, (1 + scale).to(x.dtype)))


def _after_level(film: nn.Conv2d, level: Tensor, blocks: Step) -> Step:
    """The same for features that the number of frames alone scales and shifts."""
    return lambda x: blocks(scaled_and_shifted(film, level, x))


def _known(range_fraction: Tensor, azimuth_rad: Tensor, sector: Tensor) -> tuple[Tensor, ...]:
    """The maps as the first layer gets them, centred: otherwise they drown the image."""
    return 2 * range_fraction - 1, azimuth_rad, 1 - sector


def _sector(last_plane: Tensor) -> Tensor:
    """The sector by the last plane, which is its complement, or -1 where it is unknown."""
    return 1 - last_plane.clamp_min(0)


def _unknown(noisy: Tensor) -> tuple[Tensor, ...]:
    """The same for unknown geometry; the last value occurs in no known one."""
    nothing = torch.zeros_like(noisy)
    return nothing, nothing, nothing - 1
