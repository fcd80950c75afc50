"""The factory's shards as training data.

Every crop is a pure function of the seed and of its number in the whole training, so it does not
matter which process reads it, or whether training was interrupted before.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
import torch
from torch.utils.data import Dataset, Sampler

from factory.errors import FactoryError
from factory.seeds import stream
from factory.shards.reader import Split, open_shard, shard_paths, value_range

Batch = dict[str, torch.Tensor]
"""`noisy` and `clean`, (N, 1, H, W) float32 in 0..1."""

# Well below the usual limit of 1024 open files a process.
_OPEN_FILES = 256


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
    samples: list[SampleRef] = []
    shapes, hashes = set(), []
    for path in shard_paths(dataset, split):
        with open_shard(path) as file:
            shapes.add(file["noisy"].shape[1:])
            hashes.append(str(file.attrs["config_hash"]))
            for row, meta in enumerate(file["meta"][()]):
                location, scene, frame = (meta[k].decode() for k in ("location", "scene", "frame"))
                samples.append(SampleRef(path, row, f"{location}/{scene}", frame))
    if not samples:
        raise FactoryError(f"dataset={dataset}: the {split} split holds no samples; generate some")
    if len(shapes) > 1:
        raise FactoryError(f"dataset={dataset}: images of several sizes ({sorted(shapes)})")
    height, width = shapes.pop()
    return PairTable(tuple(samples), height, width, hashes[0])


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
    """Reads pairs; each process opens a shard when it first needs it and keeps it open."""

    def __init__(self) -> None:
        self._files: dict[Path, h5py.File] = {}
        self._process = os.getpid()

    def pair(self, sample: SampleRef) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
        """(noisy, clean), each (H, W) float32 in 0..1."""
        file = self._open(sample.path)
        scale = np.float32(1 / value_range(file))
        try:
            noisy, clean = (file[key][sample.row] for key in ("noisy", "clean"))
        except OSError as error:
            raise FactoryError(
                f"{sample.path}: sample {sample.row} is damaged; generate it again"
            ) from error
        return noisy.astype(np.float32) * scale, clean.astype(np.float32) * scale

    def _open(self, path: Path) -> h5py.File:
        if self._process != os.getpid():
            # HDF5's state must not be shared across a fork.
            self._files, self._process = {}, os.getpid()
        if path not in self._files:
            if len(self._files) >= _OPEN_FILES:
                self._files.pop(next(iter(self._files))).close()
            self._files[path] = open_shard(path)
        return self._files[path]

    def __getstate__(self) -> dict[str, Any]:
        return {"_files": {}, "_process": -1}


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


class Whole(Dataset[Batch]):
    """Whole images, for validation."""

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
