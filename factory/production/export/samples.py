"""The samples of a dataset as exports take them: split by split, with images and record."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...common.array_types import Array
from ...common.errors import FactoryError
from ...dataset.pair_dataset import PairDataset

SAMPLES_PER_FILE = 1000

Value = float | int | str


@dataclass(frozen=True, eq=False)
class ExportedSample:
    """One sample of a split.

    index: counts from 0 within the split, in the order of the dataset.
    images: `flat_name` of a layer -> (H, W) array as it is stored, rgb (H, W, 3).
    record: its row of /meta.
    """

    split: str
    index: int
    images: Mapping[str, Array]
    record: Mapping[str, Value]

    @property
    def number(self) -> str:
        """The index in six digits: the name of the sample's files in the folder of its split."""
        return f"{self.index:06d}"

    @property
    def key(self) -> str:
        """SPLIT-NUMBER, which no other sample of the dataset has; sorts as the dataset does."""
        return f"{self.split}-{self.number}"

    def json_record(self) -> dict[str, Value | None]:
        """The record as strict JSON can hold it: a parameter that was not drawn (NaN) is null."""
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in self.record.items()
        }


def flat_name(layer: str) -> str:
    """A layer's name without a slash: `layers/<effect>` is called `layers_<effect>`."""
    return layer.replace("/", "_")


def read_samples(pairs: PairDataset, split: str) -> Iterator[ExportedSample]:
    """Every sample of one split of a dataset that was opened with all layers.

    Raises FactoryError where a shard has other layers, columns or sizes than the first.
    """
    dataset_index = 0
    split_index = 0
    for shard_path in pairs.paths:
        records = pairs.table(shard_path)
        if shard_path.parent.name != split:
            dataset_index += len(records)
            continue

        for record in records:
            images = _read_images(pairs, dataset_index, shard_path)
            yield ExportedSample(split, split_index, images, plain_record(record))
            dataset_index += 1
            split_index += 1


def _read_images(pairs: PairDataset, index: int, shard_path: Path) -> dict[str, Array]:
    """The images of sample `index` of the dataset, which is in the shard at `shard_path`."""
    images = pairs[index]
    for layer, image in images.items():
        if image.dtype != pairs.form.layers[layer]:
            raise FactoryError(f"{shard_path}: its layers differ in type from the other shards'")
    return {flat_name(layer): image for layer, image in images.items()}


def plain_record(record: np.void) -> dict[str, Value]:
    """A row of the sample table as Python values, with text as str."""
    values = {name: record[name].item() for name in record.dtype.names or ()}
    return {
        name: value.decode() if isinstance(value, bytes) else value
        for name, value in values.items()
    }


class FilePart(NamedTuple):
    """A file of an export, and the samples that belong into it."""

    name: str
    samples: Iterator[ExportedSample]


def divide_into_files(
    pairs: PairDataset, name_pattern: str, *, min_files: int = 1
) -> Iterator[FilePart]:
    """Files of at most SAMPLES_PER_FILE samples; read the samples of one before the next one's.

    name_pattern: of split, index of the file and number of files, for `str.format`.
    min_files: minimum number of files per split, if it has as many samples.
    """
    for split, sample_count in pairs.splits.items():
        samples_per_file = min(SAMPLES_PER_FILE, max(1, sample_count // min_files))
        file_count = math.ceil(sample_count / samples_per_file)
        split_samples = read_samples(pairs, split)
        for file_index in range(file_count):
            name = name_pattern.format(split, file_index, file_count)
            yield FilePart(name, islice(split_samples, samples_per_file))
