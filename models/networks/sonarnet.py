"""SonarNet, a light network of this project, built around what a sonar image is.

- It works on a polar grid: where the geometry of a fan image is known, the image is resampled
  to range and bearing, and the network's correction is resampled back to the fan's pixels
  (`PolarGrid`).  The noisy image itself is never resampled, so no detail is lost.
- Range, bearing and the insonified sector of every cell are inputs.  What is to be removed scales
  and shifts the features of every level (FiLM, Perez et al. 2018), and so does, pixel by pixel, how
  many frames were averaged, which changes nothing for a single frame.
- Means along whole beams and arcs are part of the features (`LineContext`).
- A second head predicts shadow, in which the image is black; a third (`BlendHead`) weighs the
  change of the whole image.
- Plain 3x3 convolutions from half resolution down: they are what a CPU does fastest.

Without geometry it works on the image as it is; in training the geometry is withheld now and then
(`forget`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, ClassVar, Literal, NamedTuple, TypeVar, cast

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass as settings_class
from torch import Tensor, nn
from torch.nn import functional

from ...factory.imaging.effect import ARTEFACTS
from ...factory.settings import STRICT
from . import DEFAULT, GEOMETRY, vector
from .network import Network, NetworkOutput, Step, down_and_up, padded

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
        widths = settings.widths
        blocks = settings.blocks
        self.core_stride = 2 ** len(widths)
        planes = 1 + len(GEOMETRY) + settings.frames
        self.intro = nn.Conv2d(4 * planes, widths[0], 3, padding=1)
        remove_inputs = ("remove",) if settings.told else ()
        # What is always forgotten is no input.
        maps = GEOMETRY if settings.forget < 1 else ()
        self.extras = (*maps, *remove_inputs, *(("frames",) if settings.frames else ()))
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
        output = self.with_heads(noisy, **extras)
        part = output.weight[:, None, None, None].to(noisy.dtype)
        return noisy + part * (output.image - noisy)

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
            core = self.core(remove, frames, GridLines(), noisy, *_unknown(noisy))
            image = self.gated(noisy + core.change, core.shadow_logits)
            return _output(image, core.shadow_logits, core.weight)
        range_fraction = extras["range_fraction"]
        azimuth_rad = extras["azimuth_rad"]
        sector = extras.get("sector", torch.ones_like(noisy))
        grid = None
        if self.settings.polar:
            grid = polar_grid(range_fraction, azimuth_rad, sector, fan=self.fan)
        if grid is None:
            planes = (padded(x, self.core_stride) for x in (azimuth_rad, range_fraction, sector))
            maps = _known(range_fraction, azimuth_rad, sector)
            core = self.core(remove, frames, MapLines.of(*planes), noisy, *maps)
            change = core.change
            logits = core.shadow_logits
        else:
            polar = sampled(torch.cat([noisy, sector], dim=1), grid.to_polar)
            maps = _known(grid.range_fraction, grid.azimuth_rad, polar[:, 1:])
            core = self.core(remove, None, GridLines(), polar[:, :1], *maps)
            cells = torch.cat([core.change, core.shadow_logits], dim=1)
            change, logits = sampled(cells, grid.to_fan).chunk(2, dim=1)
        # Outside the sector there is nothing to denoise and no shadow.
        outside = sector <= 0
        image = self.gated(noisy + change.masked_fill(outside, 0.0), logits)
        image = torch.where(outside, noisy, image)
        return _output(image, logits.masked_fill(outside, _OUTSIDE), core.weight)

    def gated(self, image: Tensor, logits: Tensor) -> Tensor:
        """The image, darker where the logits say shadow; (N, 1, H, W) both."""
        return image * torch.sigmoid(-logits) if self.settings.mask else image

    def core(
        self, remove: Tensor, frames: Tensor | None, lines: Lines, *planes: Tensor
    ) -> CoreOutput:
        """What the network computes on the grid of its inputs, inside and outside the sector.

        planes: the image and its maps as of `_known` or `_unknown`.  frames: as of
        `with_heads`.  lines: beams and arcs of the features at half resolution.
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
        x = self.intro(functional.pixel_unshuffle(torch.cat(inputs, dim=1), 2))
        if self.lines is not None:
            x = self.lines(x, lines)
        *encoders, middle = self._conditioned(remove, levels)
        x = down_and_up(x, encoders, self.downs, middle, self.ups, self.decoders)
        heads = functional.pixel_shuffle(self.outro(x), 2)[..., :height, :width]
        noisy = planes[0]
        change = heads[:, :1]
        logits = heads[:, 1:]
        # The last plane is the sector's complement, or -1 where it is unknown.
        sector = 1 - planes[-1].clamp_min(0)
        denoised = self.gated(noisy + change, logits)
        weight = self.blend(x, noisy, denoised - noisy, sector)
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
        if levels:
            more = [film(level) for film, level in zip(self.frames, levels, strict=True)]
            films = [a + b for a, b in zip(films, more, strict=True)] if films else more
        return [_after(*both) for both in zip(films, steps, strict=True)] if films else steps


def _output(image: Tensor, logits: Tensor, weight: Tensor) -> NetworkOutput:
    # A mean of one channel: without it gradients are laid out otherwise, and weights round
    # otherwise.
    return NetworkOutput(image, logits.mean(dim=1, keepdim=True), weight)


Layer = TypeVar("Layer", nn.Linear, nn.Conv2d)


def zeroed(layer: Layer) -> Layer:
    """The layer with weights that give nothing before anything is learned."""
    for weights in layer.parameters():
        nn.init.zeros_(weights)
    return layer


def _after(film: Tensor, blocks: Step) -> Step:
    """The blocks on features that were scaled and shifted before."""
    scale, shift = film.chunk(2, dim=1)
    return lambda x: blocks(torch.addcmul(shift.to(x.dtype), x, (1 + scale).to(x.dtype)))


def _known(range_fraction: Tensor, azimuth_rad: Tensor, sector: Tensor) -> tuple[Tensor, ...]:
    """The maps as the first layer gets them, centred: otherwise they drown the image."""
    return 2 * range_fraction - 1, azimuth_rad, 1 - sector


def _unknown(noisy: Tensor) -> tuple[Tensor, ...]:
    """The same for unknown geometry; the last value occurs in no known one."""
    nothing = torch.zeros_like(noisy)
    return nothing, nothing, nothing - 1


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
    """So many of them, one after another."""
    return nn.Sequential(*(ResidualBlock(channels) for _ in range(count)))


class LineContext(nn.Module):
    """Adds to features what their beams and arcs have in common, beside neighbouring ones.

    channels: of the features.  width: channels that are pooled.  It starts as the identity.
    """

    def __init__(self, channels: int, width: int = 12) -> None:
        super().__init__()
        self.pooled = nn.Conv2d(channels, width, 1)
        self.beams, self.arcs = (
            nn.Sequential(
                nn.Conv1d(width, 2 * width, 9, padding=4),
                nn.ReLU(),
                nn.Conv1d(2 * width, width, 9, padding=4),
            )
            for _ in range(2)
        )
        self.added = zeroed(nn.Conv2d(2 * width, channels, 1))

    def forward(self, x: Tensor, lines: Lines) -> Tensor:
        """(N, C, h, w) -> the same shape."""
        pooled = self.pooled(x)
        beams = self.beams(lines.means(pooled, 2))
        return lines.add(x, beams, self.arcs(lines.means(pooled, 3)), self.added)


class GridLines:
    """Columns are beams and rows are arcs: of a polar image, or of unknown geometry."""

    def means(self, x: Tensor, along: int) -> Tensor:
        """(N, C, h, w) -> (N, C, beams) for along=2, (N, C, arcs) for 3: means along each."""
        return x.float().mean(along)

    def add(self, x: Tensor, beams: Tensor, arcs: Tensor, added: nn.Conv2d) -> Tensor:
        """The features and `added` of what the beam and the arc of each cell have.

        x: (N, C, h, w).  beams: (N, D, beams).  arcs: (N, D, arcs).  added: 1x1, of 2 D channels;
        each line is convolved once, and not each of its cells.
        """
        weight = added.weight[..., 0]
        depth = beams.shape[1]
        along = functional.conv1d(beams, weight[:, :depth], added.bias)
        across = functional.conv1d(arcs, weight[:, depth:])
        return x + along[:, :, None, :] + across[:, :, :, None]


@dataclass(frozen=True, eq=False)
class MapLines:
    """The beams and arcs of a fan, for features of `shape` (h, w).

    beam, arc: (N, h * w) int64 numbers below w and h.  weight: (N, 1, h * w), 0 outside the sector.
    """

    beam: Tensor
    arc: Tensor
    weight: Tensor
    shape: tuple[int, int]

    @classmethod
    def of(cls, azimuth_rad: Tensor, range_fraction: Tensor, sector: Tensor) -> MapLines:
        """From maps of the image, (N, 1, H, W) each, for features of half its size.

        The sector's bearings and ranges are divided evenly into w beams and h arcs.
        """
        shape = sector.shape[-2] // 2, sector.shape[-1] // 2
        planes = functional.interpolate(torch.cat([azimuth_rad, range_fraction, sector], 1), shape)
        bearing, radius, inside = (planes[:, n].flatten(1) for n in range(3))

        def numbered(values: Tensor, count: int) -> Tensor:
            least, most = _extent(values, inside > 0)
            return ((values - least) / (most - least) * count).clamp(0, count - 1).long()

        beam = numbered(bearing, shape[1])
        arc = numbered(radius, shape[0])
        return cls(beam, arc, (inside > 0).to(planes.dtype)[:, None], shape)

    def means(self, x: Tensor, along: int) -> Tensor:
        """See `GridLines`."""
        numbers, count = (self.beam, self.shape[1]) if along == 2 else (self.arc, self.shape[0])
        flat = x.float().flatten(2)
        channels = x.shape[1]
        weight = self.weight.float()
        index = numbers[:, None]
        zeros = torch.zeros(x.shape[0], channels, count, device=x.device)
        total = zeros.scatter_add(2, index.expand(-1, channels, -1), flat * weight)
        cells = zeros[:, :1].scatter_add(2, index, weight)
        return total / cells.clamp_min(1)

    def add(self, x: Tensor, beams: Tensor, arcs: Tensor, added: nn.Conv2d) -> Tensor:
        """See `GridLines`."""
        spread = [self._spread(beams, self.beam), self._spread(arcs, self.arc)]
        total: Tensor = x + added(torch.cat(spread, dim=1))
        return total

    def _spread(self, along: Tensor, numbers: Tensor) -> Tensor:
        """(N, C, beams or arcs) -> (N, C, h, w): every cell gets what its line has."""
        index = numbers[:, None].expand(-1, along.shape[1], -1)
        return along.gather(2, index).reshape(*along.shape[:2], *self.shape)


Lines = GridLines | MapLines
"""The beams and arcs of the cells of a feature map."""


class PolarGrid(NamedTuple):
    """Where the cells of a polar grid lie in fan images, and the pixels of these in the grid.

    to_polar, to_fan: (N, H, W, 2) positions for `sampled`.
    range_fraction, azimuth_rad: (N, 1, H, W) of the cells, near range first.
    The grid has as many cells as the image has pixels, from the least to the largest range and
    bearing of the sector (of the whole image where it shows none of the sector).
    """

    to_polar: Tensor
    to_fan: Tensor
    range_fraction: Tensor
    azimuth_rad: Tensor


def polar_grid(
    range_fraction: Tensor, azimuth_rad: Tensor, sector: Tensor, fan: bool | None = None
) -> PolarGrid | None:
    """The grid for fan images whose pixels have these maps, each (N, 1, H, W), H and W 2 or more.

    fan: whether they are fans; None: seen from the maps.
    None for images that are polar already, or too small to tell.
    """
    if fan is None:
        columns = range_fraction[..., :1] if min(range_fraction.shape[-2:]) > 1 else range_fraction
        fan = not bool((range_fraction == columns).all())
    if not fan:
        return None
    height, width = range_fraction.shape[-2:]
    radius = range_fraction[:, 0]
    azimuth = azimuth_rad[:, 0]
    # In a fan, right and ahead of the sonar are linear in column and row (see `sonar.fan`).
    right = radius * torch.sin(azimuth)
    ahead = radius * torch.cos(azimuth)
    first_right, last_right, first_ahead, last_ahead = (
        edge.mean(1)[:, None, None]
        for edge in (right[:, :, 0], right[:, :, -1], ahead[:, 0, :], ahead[:, -1, :])
    )
    right_step = (last_right - first_right) / (width - 1)
    ahead_step = (last_ahead - first_ahead) / (height - 1)
    inside = sector[:, 0] > 0
    near, far = _extent(radius, inside)
    left, right_end = _extent(azimuth, inside)
    down = (torch.arange(height, device=radius.device) + 0.5) / height
    across = (torch.arange(width, device=radius.device) + 0.5) / width
    cell_range = (near + (far - near) * down[None, :, None]).expand_as(radius)
    cell_azimuth = (left + (right_end - left) * across[None, None, :]).expand_as(radius)
    column = (cell_range * torch.sin(cell_azimuth) - first_right) / right_step
    row = (cell_range * torch.cos(cell_azimuth) - first_ahead) / ahead_step
    to_polar = torch.stack([(2 * column + 1) / width - 1, (2 * row + 1) / height - 1], dim=-1)
    across_grid = 2 * (azimuth - left) / (right_end - left) - 1
    down_grid = 2 * (radius - near) / (far - near) - 1
    to_fan = torch.stack([across_grid, down_grid], dim=-1)
    return PolarGrid(to_polar, to_fan, cell_range[:, None], cell_azimuth[:, None])


def _extent(values: Tensor, inside: Tensor) -> tuple[Tensor, Tensor]:
    """Least and largest of each (N, ...) where `inside`, or of all of it; never equal."""
    dims = tuple(range(1, values.ndim))
    inside = inside | ~inside.flatten(1).any(1).view(-1, *[1] * len(dims))
    least = values.masked_fill(~inside, torch.inf).amin(dim=dims, keepdim=True)
    largest = values.masked_fill(~inside, -torch.inf).amax(dim=dims, keepdim=True)
    return least, largest.clamp_min(least + 1e-6)


def sampled(images: Tensor, at: Tensor) -> Tensor:
    """(N, C, H, W) at positions (N, h, w, 2) as of `grid_sample`, bilinear; edges are repeated."""
    # In 32 bits: halves of a pixel would be lost in 16 at the far side of a large image.
    with torch.autocast(images.device.type, enabled=False):
        return functional.grid_sample(
            images.float(), at, padding_mode="border", align_corners=False
        )


_FIRST_WEIGHT = 3.0  # logit of the weight before anything is learned: 95 % of the change
_DARK = 1 / 512  # a cell below this holds no echo: half a grey value of 8 bits
_CENTRE = 1.5  # centres the logarithms of grey values between _DARK and 1
_LEAST = 1e-7  # added to mean squares of grey values (70 dB), so that 0 has a logarithm
_STATISTICS = 5


class BlendHead(nn.Module):
    """Weighs the change of a whole image, 0 to 1, from the image, the change and its features.

    features: channels of the last features.  width: channels of the head itself.
    A network that has learned to remove strong noise harms an image with hardly any; the weight
    falls smoothly to zero there.  The head gets the logarithm of the image, in which a blur looks
    the same in bright and in dim places, and pools with a weight for every place (gated attention,
    Ilse et al., ICML 2018), because shadow carries no information, and maxima, because a single
    defect matters.  Statistics give at once what many layers would have to find out.

    No gradient goes back into the network, so the head cannot harm the images.
    """

    def __init__(self, features: int, width: int = 32) -> None:
        super().__init__()
        self.near = nn.Conv2d(features + 4 * 3, width, 3, stride=2, padding=1)
        self.far = nn.Conv2d(width, width, 3, padding=1)
        self.weight = nn.Conv2d(width, width, 1)
        self.mixed = nn.Linear(3 * width + _STATISTICS, width)
        self.logit = zeroed(nn.Linear(width, 1))
        nn.init.constant_(self.logit.bias, _FIRST_WEIGHT)

    def forward(self, features: Tensor, noisy: Tensor, change: Tensor, sector: Tensor) -> Tensor:
        """(N, F, h, w) at half resolution, three times (N, 1, H, W) -> (N,) weight, 0 to 1.

        h and w may be half the size of the images after padding.
        sector: 1 where insonified, else 0.
        """
        features = features.detach()
        noisy = noisy.detach()
        change = change.detach()
        height, width = (2 * size for size in features.shape[-2:])
        padding = (0, width - noisy.shape[-1], 0, height - noisy.shape[-2])
        logarithm = torch.log10(noisy.clamp_min(0) + _DARK) + _CENTRE
        planes = functional.pad(torch.cat([noisy, change, logarithm], dim=1), padding)
        planes = functional.pixel_unshuffle(planes, 2)
        x = functional.relu(self.near(torch.cat([features, planes], dim=1)))
        x = functional.relu(self.far(x))
        inside = functional.avg_pool2d(padded(functional.pad(sector, padding), 4), 4)
        weight = torch.sigmoid(self.weight(x)).float() * inside
        x = x.float() * inside
        pooled = [
            (weight * x).sum(dim=(2, 3)) / weight.sum(dim=(2, 3)).clamp_min(1e-3),
            x.sum(dim=(2, 3)) / inside.sum(dim=(2, 3)).clamp_min(1),
            x.amax(dim=(2, 3)),
            _statistics(noisy, change, sector),
        ]
        logit: Tensor = self.logit(functional.relu(self.mixed(torch.cat(pooled, dim=1))))
        return torch.sigmoid(logit[:, 0].float())


def _statistics(noisy: Tensor, change: Tensor, sector: Tensor) -> Tensor:
    """(N, 1, H, W) each -> (N, 5): four decimal logarithms and the dark fraction."""
    noisy = noisy.float()
    change = change.float()
    area = sector.sum(dim=(1, 2, 3)).clamp_min(1)

    def mean(x: Tensor) -> Tensor:
        return (x * sector).sum(dim=(1, 2, 3)) / area

    power = mean(noisy.square()) + _LEAST
    changed = mean(change.square()) + _LEAST
    range_step = _step(noisy, sector, 2) / area + _LEAST
    bearing_step = _step(noisy, sector, 3) / area + _LEAST
    return torch.stack(
        [
            torch.log10(changed),
            torch.log10(changed / power),
            torch.log10(range_step / power),
            torch.log10(range_step / bearing_step),
            mean((noisy < _DARK).float()),
        ],
        dim=1,
    )


def _step(x: Tensor, sector: Tensor, dim: int) -> Tensor:
    """(N,) sum of the squared differences to the next pixel where both are insonified.

    Of slices, which a trace follows at any size.
    """
    size = x.shape[dim] - 1
    pixels = x.narrow(dim, 0, size)
    neighbours = x.narrow(dim, 1, size)
    both = (sector.narrow(dim, 0, size) > 0) & (sector.narrow(dim, 1, size) > 0)
    return ((neighbours - pixels).square() * both).sum(dim=(1, 2, 3))
