"""The factory's shards as training data.

Every crop is a pure function of the seed and of its number in the whole training, so it does not
matter which process reads it, or whether training was interrupted before.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch.utils.data import Dataset, Sampler

from factory.errors import FactoryError
from factory.seeds import stream
from factory.shards import PairDataset
from factory.shards.handles import OpenShards
from factory.shards.pair_dataset import in_unit_range
from factory.shards.reader import Split

Batch = dict[str, torch.Tensor]
"""`noisy` and `clean`, (N, 1, H, W) float32 in 0..1."""


@dataclass(frozen=True)
class SampleRef:
    """One pair of a dataset: where it is and which scene and frame it shows."""

    path: Path
    row: int
    scene: str
    frame: str


@dataclass(frozen=True)
class PairTable:
    """All pairs of a split, the size of their images and the hash of the dataset's config."""

    samples: tuple[SampleRef, ...]
    height: int
    width: int
    config_hash: str


def read_table(dataset: str | Path, split: Split) -> PairTable:
    """List the pairs of a split.  FactoryError: no dataset, another schema, mixed image sizes."""
    with PairDataset(dataset, split) as pairs:
        if not len(pairs):
            raise FactoryError(
                f"dataset={dataset}: the {split} split holds no samples; generate some"
            )
        places = (pairs.place(index) for index in range(len(pairs)))
        samples = tuple(
            SampleRef(
                path, row, f"{_text(meta['location'])}/{_text(meta['scene'])}", _text(meta["frame"])
            )
            for (path, row), meta in zip(places, pairs.meta(), strict=True)
        )
        height, width = pairs.shape
        return PairTable(samples, height, width, pairs.config_hash)


def _text(value: bytes) -> str:
    return value.decode(errors="replace")


def hold_out(
    samples: tuple[SampleRef, ...], fraction: float, seed: int
) -> tuple[tuple[SampleRef, ...], tuple[SampleRef, ...]]:
    """Split into (training, validation) by scene, or by frame when there is one scene only.

    At least one scene or frame goes to each side; all variants of a frame stay together.
    """
    names = sorted({sample.scene for sample in samples})
    by_scene = len(names) > 1
    if not by_scene:
        names = sorted({sample.frame for sample in samples})
    if len(names) < 2:
        raise FactoryError("dataset: its train split has one frame; validation needs another one")
    count = min(max(1, round(fraction * len(names))), len(names) - 1)
    order = stream(seed, "validation").permutation(len(names))
    held = {names[index] for index in order[:count]}

    def is_held(sample: SampleRef) -> bool:
        return (sample.scene if by_scene else sample.frame) in held

    return (
        tuple(sample for sample in samples if not is_held(sample)),
        tuple(sample for sample in samples if is_held(sample)),
    )


def spread(samples: tuple[SampleRef, ...], limit: int | None) -> tuple[SampleRef, ...]:
    """At most `limit` of the samples, evenly spaced."""
    if limit is None or len(samples) <= limit:
        return samples
    return tuple(samples[index * len(samples) // limit] for index in range(limit))


class Shards:
    """Reads pairs, in any process."""

    def __init__(self) -> None:
        self._open = OpenShards()

    def pair(self, sample: SampleRef) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """(noisy, clean), each (H, W) float32 in 0..1."""
        noisy, clean = self._open.read(sample.path, ("noisy", "clean"), sample.row)
        return in_unit_range(noisy), in_unit_range(clean)


class Crops(Dataset[Batch]):
    """Training crops; item (number, index) is what draw `number` cuts out of pair `index`."""

    def __init__(
        self, samples: tuple[SampleRef, ...], *, patch: int, flip: bool, seed: int
    ) -> None:
        self.samples, self.patch, self.flip, self.seed = samples, patch, flip, seed
        self._shards = Shards()

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, item: tuple[int, int]) -> Batch:
        number, index = item
        noisy, clean = self._shards.pair(self.samples[index])
        rng = stream(self.seed, "crop", number)
        top, left = (int(rng.integers(size - self.patch + 1)) for size in noisy.shape)
        window = np.s_[top : top + self.patch, left : left + self.patch]
        step = -1 if self.flip and rng.random() < 0.5 else 1
        return {
            name: torch.from_numpy(image[window][:, ::step].copy())[None]
            for name, image in (("noisy", noisy), ("clean", clean))
        }


class Pairs(Dataset[Batch]):
    """A split of a dataset for a torch DataLoader: whole images, in order."""

    def __init__(self, dataset: str | Path, split: Split = "train") -> None:
        self.pairs = PairDataset(dataset, split, scaled=True)

    def __len__(self) -> int:
        return len(self.pairs)

    def __getitem__(self, index: int) -> Batch:
        return {name: torch.from_numpy(image)[None] for name, image in self.pairs[index].items()}


class Whole(Dataset[Batch]):
    """Some whole images, for validation."""

    def __init__(self, samples: tuple[SampleRef, ...]) -> None:
        self.samples = samples
        self._shards = Shards()

    def __len__(self) -> int:
        return len(self.samples)

    def __getitem__(self, index: int) -> Batch:
        noisy, clean = self._shards.pair(self.samples[index])
        return {"noisy": torch.from_numpy(noisy)[None], "clean": torch.from_numpy(clean)[None]}


class Draws(Sampler[tuple[int, int]]):
    """The draws of one check interval: (number in the whole training, index of the pair).

    All pairs are drawn once, in random order, before any is drawn again.
    """

    def __init__(self, pairs: int, per_interval: int, seed: int) -> None:
        self.pairs, self.per_interval, self.seed = pairs, per_interval, seed
        self._interval = 0

    def set_epoch(self, epoch: int) -> None:
        """Lightning calls this with the number of the interval, also after resuming."""
        self._interval = epoch

    def __len__(self) -> int:
        return self.per_interval

    def __iter__(self) -> Iterator[tuple[int, int]]:
        first = self._interval * self.per_interval
        round_, order = -1, np.empty(0, dtype=np.int64)
        for number in range(first, first + self.per_interval):
            if number // self.pairs != round_:
                round_ = number // self.pairs
                order = stream(self.seed, "order", round_).permutation(self.pairs)
            yield number, int(order[number % self.pairs])
