"""Which sample lies where: read from the shards themselves, for the card and the contact sheet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import h5py

from simnfnd.factory.dataset.format.manifest import Manifest
from simnfnd.factory.errors import FactoryError


@dataclass(frozen=True)
class SampleName:
    """One sample: row `row` of the shard at `path`, and what it is of."""

    path: str
    row: int
    split: str
    location: str
    scene: str
    frame: str
    variant: int


@dataclass(frozen=True)
class Overview:
    """All samples of a dataset in the order of the shards, and the form of the images.

    shape: (rows, columns).  axes: (name, units) of rows and columns.
    """

    samples: tuple[SampleName, ...]
    shape: tuple[int, int]
    dtype: str
    axes: tuple[tuple[str, str], tuple[str, str]]

    def counts(self) -> Mapping[tuple[str, str, str], int]:
        """(split, location, scene) -> samples, in the order of the shards."""
        counts: dict[tuple[str, str, str], int] = {}
        for sample in self.samples:
            key = (sample.split, sample.location, sample.scene)
            counts[key] = counts.get(key, 0) + 1
        return counts


def read_overview(directory: Path, manifest: Manifest) -> Overview:
    """Read the names of all samples.

    Raises FactoryError when the dataset has no shard, or one cannot be read.
    """
    samples: list[SampleName] = []
    form: tuple[tuple[int, int], str, tuple[tuple[str, str], tuple[str, str]]] | None = None
    # Train comes before test here, though not in the alphabet.
    for path in sorted(manifest.shards, key=lambda name: (not name.startswith("train"), name)):
        split = manifest.shards[path].split
        try:
            with h5py.File(directory / path, "r") as file:
                table = file["meta"][:]
                noisy = file["noisy"]
                scales = [noisy.dims[dimension][0] for dimension in (1, 2)]
                rows, columns = (
                    (scale.name.removeprefix("/axes/"), str(scale.attrs["units"]))
                    for scale in scales
                )
                form = (noisy.shape[1:], str(noisy.dtype), (rows, columns))
        except (OSError, KeyError, RuntimeError) as error:
            raise FactoryError(
                f"{directory / path}: cannot be read; run the command that made the dataset again"
            ) from error
        samples += [
            SampleName(
                path,
                row,
                split,
                record["location"].decode(),
                record["scene"].decode(),
                record["frame"].decode(),
                int(record["variant"]),
            )
            for row, record in enumerate(table)
        ]
    if form is None:
        raise FactoryError(f"{directory}: the dataset has no samples")
    return Overview(tuple(samples), *form)
