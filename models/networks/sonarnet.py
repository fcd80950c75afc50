"""SonarNet, a light network of this project, built around what a sonar picture is.

- It works on a polar grid: where the geometry of a fan picture is known, the picture is resampled
  to range and bearing, and the network's correction is resampled back to the fan's pixels
  (`networks.polar`).  The noisy picture itself is never resampled, so no detail is lost.
- Range, bearing and the insonified sector of every cell are inputs, and what is to be removed is
  told, too: six numbers that scale and shift the features of every level (FiLM, Perez et al. 2018).
- Means along whole beams and arcs are part of the features (`networks.lines`).
- A second head predicts shadow (black in the clean picture); the picture is multiplied by one minus
  that.
- A third (`networks.blend_head`) weighs the change of the whole picture, which falls to nothing
  where hardly anything is wrong with it.
- Plain 3x3 convolutions from half resolution down: they are what a CPU does fastest.

Without geometry it works on the picture as it is; in training the geometry is withheld now and then
(`forget`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor, nn
from torch.nn import functional

from ...factory.imaging.contract import ARTEFACTS
from ...factory.settings import STRICT
from ..removal import DEFAULT, vector
from .blend_head import BlendHead
from .lines import GridLines, LineContext, MapLines
from .network import Network, NetworkOutput, Step, down_and_up, padded
from .polar import polar_grid
from .unet import residual_blocks

_MAPS = ("range_fraction", "azimuth_rad", "sector")
_TOLD = 32  # features of what is to be removed
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
    mirror: whether it also denoises the mirrored picture and averages both results, for twice the
    work; not in training, so trained weights may change it.
    forget: part of the training steps in which the network gets no geometry.
    wide_grain: correlation of neighbouring pixels' grain from which on `simnfnd denoise` denoises
        a picture at half its size first (`models.denoise.scales`); 1: never; not in training, so
        trained weights may change it.
    told: whether the network is told what to remove; else it always removes the same.
    channels: of the images; 1, so that colours are denoised one by one.
    """

    kind: Literal["sonarnet"]
    widths: tuple[Annotated[int, Field(ge=1, le=1024)], ...]
    blocks: tuple[Annotated[int, Field(ge=0, le=64)], ...]
    polar: bool
    lines: bool
    mask: bool
    forget: Annotated[float, Field(ge=0, le=1)]
    mirror: bool = False
    wide_grain: Annotated[float, Field(ge=0, le=1)] = 1.0
    told: bool = True
    channels: Literal[1] = 1

    def __post_init__(self) -> None:
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
        super().__init__(settings.channels, stride=1)
        self.settings = settings
        self.wide_grain = settings.wide_grain
        # Whether known geometries are those of fans; None: seen from the maps.
        self.fan: bool | None = None
        widths, blocks = settings.widths, settings.blocks
        self.core_stride = 2 ** len(widths)
        self.intro = nn.Conv2d(4 * (1 + len(_MAPS)), widths[0], 3, padding=1)
        self.extras = (*_MAPS, "remove") if settings.told else _MAPS
        if settings.told:
            self.told = nn.Sequential(nn.Linear(len(ARTEFACTS), _TOLD), nn.ReLU())
            self.films = nn.ModuleList(_film(width) for width in widths)
        self.lines = LineContext(widths[0]) if settings.lines else None
        self.encoders, self.downs = nn.ModuleList(), nn.ModuleList()
        self.ups, self.decoders = nn.ModuleList(), nn.ModuleList()
        for fine, coarse, count in zip(widths, widths[1:], blocks, strict=False):
            self.encoders.append(residual_blocks(fine, count))
            self.downs.append(nn.Conv2d(fine, coarse, 2, stride=2))
            self.ups.insert(0, nn.ConvTranspose2d(coarse, fine, 2, stride=2))
            self.decoders.insert(0, residual_blocks(fine, count))
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
        `formation.contract.ARTEFACTS`); without it the usual ones.
        """
        output = self._single_pass(noisy, extras)
        if self.training or not self.settings.mirror:
            return output
        maps = {name: extras[name].flip(-1) for name in _MAPS if name in extras}
        if "azimuth_rad" in maps:
            maps["azimuth_rad"] = -maps["azimuth_rad"]
        image, shadow, weight = self._single_pass(noisy.flip(-1), {**extras, **maps})
        return NetworkOutput(
            (output.image + image.flip(-1)) / 2,
            (output.shadow_logits + shadow.flip(-1)) / 2,
            (output.weight + weight) / 2,
        )

    def _single_pass(self, noisy: Tensor, extras: Mapping[str, Tensor]) -> NetworkOutput:
        remove = extras.get("remove")
        if remove is None:
            usual = torch.from_numpy(vector(DEFAULT)).to(noisy)
            remove = usual.expand(noisy.shape[0], -1)
        has_geometry = "range_fraction" in extras and "azimuth_rad" in extras
        if self.training and has_geometry and self.settings.forget:
            has_geometry = bool(torch.rand(()) >= self.settings.forget)
        if not has_geometry:
            change, logits, weight = self._core(remove, None, noisy, *_unknown(noisy))
            return NetworkOutput(self._gated(noisy + change, logits), logits, weight)
        range_fraction, azimuth_rad = extras["range_fraction"], extras["azimuth_rad"]
        sector = extras.get("sector", torch.ones_like(noisy))
        grid = None
        if self.settings.polar:
            grid = polar_grid(range_fraction, azimuth_rad, sector, fan=self.fan)
        if grid is None:
            found = (azimuth_rad, range_fraction, sector)
            maps = _known(range_fraction, azimuth_rad, sector)
            change, logits, weight = self._core(remove, found, noisy, *maps)
        else:
            polar = grid.polar(torch.cat([noisy, sector], dim=1))
            maps = _known(grid.range_fraction, grid.azimuth_rad, polar[:, 1:])
            *cells, weight = self._core(remove, None, polar[:, :1], *maps)
            change, logits = grid.fan(torch.cat(cells, dim=1)).chunk(2, dim=1)
        # Outside the sector there is nothing to denoise and no shadow.
        inside = sector > 0
        change = change.masked_fill(~inside, 0.0)
        image = self._gated(noisy + change, logits)
        image = torch.where(inside, image, noisy)
        return NetworkOutput(image, logits.masked_fill(~inside, _OUTSIDE), weight)

    def _gated(self, image: Tensor, logits: Tensor) -> Tensor:
        return image * torch.sigmoid(-logits) if self.settings.mask else image

    def _core(
        self, remove: Tensor, maps: tuple[Tensor, Tensor, Tensor] | None, *planes: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What to add and logits of shadow, (N, 1, H, W) as the planes; the weight, (N,).

        maps: azimuth, range and sector of a fan; None where columns are beams and rows ranges.
        """
        height, width = planes[0].shape[-2:]
        x = torch.cat([padded(plane, self.core_stride) for plane in planes], dim=1)
        x = self.intro(functional.pixel_unshuffle(x, 2))
        if self.lines is not None:
            if maps is None:
                x = self.lines(x, GridLines())
            else:
                azimuth, radius, inside = (padded(plane, self.core_stride) for plane in maps)
                shape = (x.shape[-2], x.shape[-1])
                x = self.lines(x, MapLines.of(azimuth, radius, inside, shape))
        encoders: list[Step] = list(self.encoders)
        middle: Step = self.middle
        if self.settings.told:
            told = self.told(remove)
            *films, coarsest = [film(told) for film in self.films]
            encoders = [_after(*both) for both in zip(films, encoders, strict=True)]
            middle = _after(coarsest, middle)
        x = down_and_up(x, encoders, self.downs, middle, self.ups, self.decoders)
        heads = functional.pixel_shuffle(self.outro(x), 2)[..., :height, :width]
        noisy, change, logits = planes[0], heads[:, :1], heads[:, 1:]
        # The last plane is the sector's complement, or -1 where it is unknown.
        sector = 1 - planes[-1].clamp_min(0)
        denoised = self._gated(noisy + change, logits)
        return change, logits, self.blend(x, noisy, denoised - noisy, sector)


def _film(width: int) -> nn.Linear:
    """Scales and shifts of `width` channels; none before anything is learned."""
    film = nn.Linear(_TOLD, 2 * width)
    nn.init.zeros_(film.weight)
    nn.init.zeros_(film.bias)
    return film


def _after(film: Tensor, blocks: Step) -> Step:
    """The blocks on features that were scaled and shifted before."""
    scale, shift = film[:, :, None, None].chunk(2, dim=1)
    return lambda x: blocks(torch.addcmul(shift.to(x.dtype), x, (1 + scale).to(x.dtype)))


def _known(range_fraction: Tensor, azimuth_rad: Tensor, sector: Tensor) -> tuple[Tensor, ...]:
    """The maps as the first layer gets them, centred: otherwise they drown the picture."""
    return 2 * range_fraction - 1, azimuth_rad, 1 - sector


def _unknown(noisy: Tensor) -> tuple[Tensor, ...]:
    """The same for unknown geometry; the last value occurs in no known one."""
    nothing = torch.zeros_like(noisy)
    return nothing, nothing, nothing - 1
