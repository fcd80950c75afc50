"""Which sample lies where: read from the shards themselves, for the card and the contact sheet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ...errors import FactoryError
from ..format.axes import image_axes
from ..format.manifest import Manifest
from .reader import reading


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
    """Read the names of all samples of a dataset that can be trusted, or was checked.

    Raises FactoryError when the dataset has no shard, or one cannot be read.
    """
    samples: list[SampleName] = []
    form: tuple[tuple[int, int], str, tuple[tuple[str, str], tuple[str, str]]] | None = None
    # Train comes before test here, though not in the alphabet.
    for path in sorted(manifest.shards, key=lambda name: (not name.startswith("train"), name)):
        split = manifest.shards[path].split
        with reading(directory / path) as file:
            table = file["meta"][()]
            noisy = file["noisy"]
            rows, columns = image_axes(noisy)
            form = (
                noisy.shape[1:],
                str(noisy.dtype),
                ((rows.name, rows.units), (columns.name, columns.units)),
            )
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
