"""Training crops: which images, in what order, and which parts of them.

Every crop is a pure function of the seed and of the number of its visit in the whole training, so
neither the process that makes it nor an interruption of the training matters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cached_property, lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch.utils.data import Dataset, Sampler

from ...factory.dataset.pair_dataset import mixed_order
from ...factory.seeds import stream
from ..settings import DataSettings
from .pairs import Batch, Sample, Source

KEPT = 96
"""Pictures in memory; one of 700x500 pixels takes 4 MB."""


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
        self, source: Source, data: DataSettings, seed: int, extras: Sequence[str] = ()
    ) -> None:
        self.source, self.data, self.seed, self.extras = source, data, seed, tuple(extras)

    def __getitem__(self, visit: Visit) -> Batch:
        sample = self.source.sample(visit.image, visit.round)
        rng = stream(self.seed, "crop", visit.number)
        shape = tuple(min(self.data.patch, side) for side in sample.noisy.shape)
        parts = []
        for _ in range(self.data.crops):
            top, left = (
                int(rng.integers(whole - side + 1))
                for whole, side in zip(sample.noisy.shape, shape, strict=True)
            )
            parts.append(crop(sample, (top, left), shape, bool(rng.random() < 0.5), self.extras))
        return concatenate(parts)


def whole_image(sample: Sample, extras: Sequence[str] = ()) -> Batch:
    """A sample as a batch of one."""
    return crop(sample, (0, 0), sample.noisy.shape, False, extras)


def crop(
    sample: Sample,
    corner: tuple[int, int],
    shape: tuple[int, ...],
    flip: bool,
    extras: Sequence[str] = (),
) -> Batch:
    """A batch of one of `shape` (rows, columns) from `corner` on, mirrored left to right or not."""
    (top, left), (height, width) = corner, shape
    window = np.s_[top : top + height, left : left + width]
    step = -1 if flip else 1
    planes = {"noisy": sample.noisy, "clean": sample.clean}
    # Crops of a batch have the same planes.
    shadow, frames = sample.shadow, sample.frames
    planes["shadow"] = np.full_like(sample.noisy, np.nan) if shadow is None else shadow
    if "frames" in extras:
        planes["frames"] = np.zeros_like(sample.noisy) if frames is None else frames
    images = {name: one[window][:, ::step] for name, one in planes.items()}
    if sample.geometry is not None and extras:
        maps = sample.geometry.maps(top, left, height, width)
        images |= {name: maps[name][:, ::step] for name in extras if name in maps}
        if flip and "azimuth_rad" in images:
            images["azimuth_rad"] = -images["azimuth_rad"]
    batch = {name: torch.from_numpy(x.copy())[None, None] for name, x in images.items()}
    return batch | {"taught": torch.full((1, 1, 1, 1), sample.taught)}


def concatenate(batches: Sequence[Batch]) -> Batch:
    """One batch of several, in order."""
    return {name: torch.cat([batch[name] for batch in batches]) for name in batches[0]}


class VisitSampler(Sampler[list[Visit]]):
    """The visits of each step from `step` to the next check; a batch sampler.

    All images are visited once, in random order, before any is visited again.
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
        self.images, self.data, self.every, self.seed = images, data, every, seed
        self.step = 0
        self._places = places
        self._orders: dict[int, npt.NDArray[np.int64]] = {}

    def __iter__(self) -> Iterator[list[Visit]]:
        each = self.data.batch // self.data.crops
        for step in range(self.step, (self.step // self.every + 1) * self.every):
            yield [self._visit(step * each + number) for number in range(each)]

    def _visit(self, number: int) -> Visit:
        round_, place = divmod(self._drawn(number), self.images)
        if round_ not in self._orders:
            rng = stream(self.seed, "order", round_)
            order = mixed_order(self._places, rng) if self._places else rng.permutation(self.images)
            # A kept picture can be one of the round before, and of few images of earlier ones.
            self._orders = {r: o for r, o in self._orders.items() if r >= round_ - KEPT}
            self._orders[round_] = order
        return Visit(number, int(self._orders[round_][place]), round_)

    def _drawn(self, number: int) -> int:
        """The number of a visit's picture when each serves `data.reuse` visits on average.

        Every `reuse`-th visit shows the next picture, the others one of the last `KEPT`.
        """
        newest, is_old = divmod(number, self.data.reuse)
        if is_old:
            newest -= int(stream(self.seed, "reuse", number).integers(KEPT))
        return max(newest, 0)


class KeptSource(Source):
    """The last `KEPT` samples of a source are not made again."""

    images: Source

    def __init__(self, source: Source) -> None:
        self.images = source

    @cached_property
    def _kept(self) -> Callable[[int, int | None], Sample]:
        return lru_cache(KEPT)(self.images.sample)

    def sample(self, index: int, visit: int | None) -> Sample:
        """See `Source`."""
        return self._kept(index, visit)
