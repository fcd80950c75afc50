"""Training crops: which images, in what order, and which parts of them.

Every crop is a pure function of the seed and of the number of its visit in the whole training, so
neither the process that makes it nor an interruption of the training matters.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch.utils.data import Dataset, Sampler

from ...factory.common.array_types import Float32s, Int64s
from ...factory.common.seeds import stream
from ...factory.dataset.pair_dataset import mixed_order
from ..networks.bearing_view import (
    BEARINGS,
    SEGMENTS,
    Sector,
    bearing_view,
    sector_of,
    segment_means,
)
from ..settings import DataSettings
from .displays import Display, ImagePart, compressed, draw_display, resized_planes, show, with_greys
from .pairs import Batch, ImageSource, TrainingImage
from .radial import with_radial

LANES = 8
"""Steps that follow each other draw their images from this many lanes; see `VisitSampler`."""
KEPT_IN_LANE = 12
"""Images of a lane that are visited again."""
KEPT = LANES * KEPT_IN_LANE
"""Images in memory; one of 700x500 pixels takes 4 MB."""
_AS_IT_IS = Display()
_HALF = 0.5  # of a pixel inside the sector makes it one of the sector


class Visit(NamedTuple):
    """One image to be cropped.

    number: of the visit in the whole training.  image: its index.  round: how often the image was
    visited before.
    """

    number: int
    image: int
    round: int


class Crops(Dataset[Batch]):
    """Training crops; item `Visit` is a batch of `data.crops` of them, all of one image.

    They have `data.patch` pixels a side; of smaller images they are the whole.
    extras: names of maps to add, as `models.networks` describes them.
    """

    def __init__(
        self, source: ImageSource, data: DataSettings, seed: int, extras: Sequence[str] = ()
    ) -> None:
        self.source = source
        self.data = data
        self.seed = seed
        self.extras = tuple(extras)

    def __getitem__(self, visit: Visit) -> Batch:
        sample = self.source.sample(visit.image, visit.round)
        if self.data.radial:
            draws = stream(self.seed, "radial", visit.number)
            if draws.random() < self.data.radial:
                sample = with_radial(sample, draws)
        rng = stream(self.seed, "crop", visit.number)
        shape = tuple(min(self.data.patch, side) for side in sample.noisy.shape)
        display = Display()
        if self.data.displays:
            draws = stream(self.seed, "display", visit.number)
            if draws.random() < self.data.displays:
                display = draw_display(draws)
        extent = extent_of(shape, sample.noisy.shape, display.scale)
        views = whole_bearings(sample, display) if "bearings" in self.extras else None
        parts = []
        for _ in range(self.data.crops):
            top, left = (
                int(rng.integers(whole - side + 1))
                for whole, side in zip(sample.noisy.shape, extent, strict=True)
            )
            flip = bool(rng.random() < 0.5)
            part = crop(sample, (top, left), extent, flip, self.extras, display)
            part = part if extent == shape else scaled(part, shape)
            if display.quality:
                noisy = compressed(part["noisy"][0, 0].numpy(), display.quality)
                part["noisy"] = torch.from_numpy(noisy)[None, None]
            if views is not None:
                part["bearing_sector"] = views.limits(mirrored=flip)
            parts.append(part)
        batch = concatenate(parts)
        return batch if views is None else batch | views.batch()


def whole_image(sample: TrainingImage, extras: Sequence[str] = ()) -> Batch:
    """A sample as a batch of one."""
    batch = crop(sample, (0, 0), sample.noisy.shape, False, extras)
    views = whole_bearings(sample) if "bearings" in extras else None
    if views is None:
        return batch
    return batch | views.batch() | {"bearing_sector": views.limits(mirrored=False)}


@dataclass(frozen=True, eq=False)
class WholeBearings:
    """What a network sees of an image's whole bearings; see `networks.bearing_view`.

    view: (2, RANGES, BEARINGS).  interference: (SEGMENTS, BEARINGS), what is to be taken off.
    """

    view: Float32s
    interference: Float32s
    sector: Sector

    def limits(self, *, mirrored: bool) -> torch.Tensor:
        """(1, 4) sector of a crop, which may be mirrored."""
        near, far, left_rad, right_rad = self.sector
        sign = -1 if mirrored else 1
        return torch.tensor([[near, far, sign * left_rad, sign * right_rad]])

    def batch(self) -> Batch:
        """Planes that all crops of the image share."""
        return {
            "bearings": torch.from_numpy(self.view)[None],
            "interference": torch.from_numpy(self.interference)[None],
        }


def whole_bearings(sample: TrainingImage, display: Display = _AS_IT_IS) -> WholeBearings | None:
    """The whole bearings of a sample as it is shown; None where its geometry is unknown."""
    geometry = sample.geometry
    if geometry is None:
        return None
    height, width = sample.noisy.shape
    place = ImagePart(0, 0, (height, width), (height, width))
    rows, columns = (max(2, round(side * display.scale)) for side in (height, width))

    def seen(image: Float32s) -> Float32s:
        if display != _AS_IT_IS:
            image = with_greys(show(image, display, place), display.greys)
        if geometry.layout == "polar" or display.scale == 1:
            return bearing_view(image, geometry)
        image = resized_planes({"image": image}, (rows, columns))["image"]
        return bearing_view(image, geometry.scaled(rows, columns, display.scale))

    view = seen(sample.noisy)
    interference = np.zeros((SEGMENTS, BEARINGS), np.float32)
    if sample.undisturbed is not None:
        interference = segment_means(view) - segment_means(seen(sample.undisturbed))
    return WholeBearings(view, interference, sector_of(geometry))


def extent_of(
    shape: tuple[int, ...], image_shape: tuple[int, ...], scale: float
) -> tuple[int, ...]:
    """Sides of the window that a crop of `shape` shows at a scale, as far as the image allows."""
    least = max(side / whole for side, whole in zip(shape, image_shape, strict=True))
    return tuple(round(side / max(scale, least)) for side in shape)


def crop(
    sample: TrainingImage,
    corner: tuple[int, int],
    shape: tuple[int, ...],
    flip: bool,
    extras: Sequence[str] = (),
    display: Display = _AS_IT_IS,
) -> Batch:
    """A batch of one of `shape` (rows, columns) from `corner` on, mirrored left to right or not.

    display: how noisy and clean image are shown, but for its size, which `scaled` changes.
    """
    top, left = corner
    height, width = shape
    window = np.s_[top : top + height, left : left + width]
    step = -1 if flip else 1
    planes = {"noisy": sample.noisy, "clean": sample.clean}
    # Crops of a batch have the same planes.
    shadow = sample.shadow
    frames = sample.frames
    planes["shadow"] = np.full_like(sample.noisy, np.nan) if shadow is None else shadow
    if "frames" in extras:
        planes["frames"] = np.zeros_like(sample.noisy) if frames is None else frames
    parts = {name: plane[window] for name, plane in planes.items()}
    if display != _AS_IT_IS:
        rows, columns = sample.noisy.shape
        place = ImagePart(top, left, (height, width), (rows, columns))
        parts["clean"] = show(parts["clean"], display, place)
        parts["noisy"] = with_greys(show(parts["noisy"], display, place), display.greys)
    images = {name: part[:, ::step] for name, part in parts.items()}
    if sample.geometry is not None and extras:
        maps = sample.geometry.maps(top, left, height, width)
        images |= {name: maps[name][:, ::step] for name in extras if name in maps}
        if flip and "azimuth_rad" in images:
            images["azimuth_rad"] = -images["azimuth_rad"]
    return {name: torch.from_numpy(x.copy())[None, None] for name, x in images.items()}


def scaled(part: Batch, shape: tuple[int, ...]) -> Batch:
    """A crop at another size, (rows, columns)."""
    rows, columns = shape
    planes = {name: plane[0, 0].numpy() for name, plane in part.items()}
    resized = resized_planes(planes, (rows, columns))
    if "sector" in resized:
        resized["sector"] = (resized["sector"] > _HALF).astype(np.float32)
    return {name: torch.from_numpy(plane)[None, None] for name, plane in resized.items()}


def concatenate(batches: Sequence[Batch]) -> Batch:
    """One batch of several, in order."""
    return {name: torch.cat([batch[name] for batch in batches]) for name in batches[0]}


class VisitSampler(Sampler[list[Visit]]):
    """The visits of each step from `step` to the next check; a batch sampler.

    With `data.reuse` 1 all images are visited once, in random order, before any is visited again.

    With more, a step draws its images from one of `LANES` lanes, which take turns: every
    `reuse`-th visit of a lane shows a new image, the others one of the last `KEPT_IN_LANE`.  The
    steps of a lane go to the same reading process where the number of processes divides `LANES`,
    so an image is made once, by one process.
    """

    def __init__(
        self,
        images: int,
        data: DataSettings,
        every: int,
        seed: int,
        places: Sequence[Path] | None = None,
    ) -> None:
        """images: how many there are.  every: steps of an interval.

        places: the shard of each image, where shards are fetched; see `mixed_order`.
        """
        self.images = images
        self.data = data
        self.every = every
        self.seed = seed
        self.step = 0
        self._places = places
        self._orders: dict[int, Int64s] = {}

    def __iter__(self) -> Iterator[list[Visit]]:
        interval_end = (self.step // self.every + 1) * self.every
        for step in range(self.step, interval_end):
            yield [self._visit(step, place) for place in range(self._visits_of_a_step)]

    @property
    def _visits_of_a_step(self) -> int:
        return self.data.batch // self.data.crops

    def _visit(self, step: int, place: int) -> Visit:
        """The visit at a place of a step's batch."""
        number = step * self._visits_of_a_step + place
        draw = number if self.data.reuse == 1 else self._reused_draw(step, place)
        round_, position = divmod(draw, self.images)
        return Visit(number, int(self._order(round_)[position]), round_)

    def _reused_draw(self, step: int, place: int) -> int:
        """Which image this visit shows, counted over all that are drawn in the training."""
        interval, offset = divmod(step, self.every)
        lane = offset % LANES
        steps_of_lane = len(range(lane, self.every, LANES))
        step_in_lane = interval * steps_of_lane + offset // LANES
        visit_in_lane = step_in_lane * self._visits_of_a_step + place

        draw_in_lane, visits_since_new = divmod(visit_in_lane, self.data.reuse)
        if visits_since_new:
            choices = min(KEPT_IN_LANE, draw_in_lane + 1)
            draw_in_lane -= int(stream(self.seed, "reuse", step, place).integers(choices))
        return draw_in_lane * LANES + lane

    def _order(self, round_: int) -> Int64s:
        """All images in the order of a round."""
        if round_ not in self._orders:
            # A kept image can be one of an earlier round, of few images of a much earlier one.
            oldest = round_ - KEPT
            self._orders = {n: order for n, order in self._orders.items() if n >= oldest}
            rng = stream(self.seed, "order", round_)
            order = mixed_order(self._places, rng) if self._places else rng.permutation(self.images)
            self._orders[round_] = order
        return self._orders[round_]


class KeptSource(ImageSource):
    """A source whose last samples are not made again."""

    images: ImageSource

    def __init__(self, source: ImageSource, processes: int = 1) -> None:
        """processes: how many share the lanes of `VisitSampler`."""
        self.images = source
        # Some lanes draw their next image before others do.
        self._capacity = -(-KEPT // processes) + LANES
        self._samples: OrderedDict[tuple[int, int | None], TrainingImage] = OrderedDict()

    def sample(self, index: int, visit: int | None) -> TrainingImage:
        """See `ImageSource`."""
        key = (index, visit)
        if key not in self._samples:
            if len(self._samples) == self._capacity:
                self._samples.popitem(last=False)
            self._samples[key] = self.images.sample(index, visit)
        return self._samples[key]
