"""A dataset as a whole: its form, its tables, its samples one after another, what it is called.

Exports, cards, previews, summaries and merges are made of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ..errors import FactoryError
from ..small_files import load_yaml, one_line
from .layout import config_of, image_axes, optional_layers
from .manifest import CONFIG_NAME
from .reader import ImageStack, Split, reading, shard_paths
from .schema import CORE, DATASET_NAME, Axis, Column

Value = float | int | str


@dataclass(frozen=True, eq=False)
class Sample:
    """One sample.

    split, number: number counts from 0 within the split, in the order of the shards.
    images: name -> (H, W) array as it is stored, rgb (H, W, 3); the optional `layers/<effect>` are
        called `layers_<effect>`.
    record: its row of /meta.
    """

    split: str
    number: int
    images: Mapping[str, npt.NDArray[Any]]
    record: Mapping[str, Value]

    @property
    def key(self) -> str:
        """Unique in the dataset, sorts as the dataset does, holds no dot or slash."""
        return f"{self.split}-{self.number:06d}"


@dataclass(frozen=True)
class SampleName:
    """One sample: row `row` of the shard at `path`, and what it is of."""

    path: Path
    row: int
    split: str
    location: str
    scene: str
    frame: str
    variant: int


@dataclass(frozen=True, eq=False)
class Source:
    """A dataset, or some of its shards.

    shards: (split, path, samples) of every shard, in order.  layers: names and dtypes of the
    images, the core ones first.  sizes: their shapes.  axes: of rows and columns.
    config: the settings in the first shard.  table: the dtype of /meta.
    """

    directory: Path
    shards: tuple[tuple[str, Path, int], ...]
    layers: Mapping[str, np.dtype[Any]]
    sizes: Mapping[str, tuple[int, ...]]
    columns: tuple[Column, ...]
    axes: tuple[Axis, Axis]
    config: Mapping[str, Any]
    config_hash: str
    table: np.dtype[np.void]

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the sonar's pictures."""
        height, width = self.sizes["noisy"]
        return height, width

    @property
    def splits(self) -> dict[str, int]:
        """Split -> number of samples, of the splits that have any."""
        counts: dict[str, int] = {}
        for split, _, samples in self.shards:
            counts[split] = counts.get(split, 0) + samples
        return counts

    @property
    def dtype(self) -> str:
        """Of noisy and clean: uint8 or float32."""
        return str(self.layers["noisy"])

    @property
    def layout(self) -> str:
        """Polar (range x azimuth) or fan."""
        return "polar" if self.axes[1].name == "azimuth" else "fan"

    def tables(self) -> Iterator[tuple[str, Path, npt.NDArray[np.void]]]:
        """(split, path, /meta) of every shard.  Raises FactoryError when their columns differ."""
        for split, path, _ in self.shards:
            with reading(path) as file:
                rows: npt.NDArray[np.void] = file["meta"][()]
            if rows.dtype != self.table:
                raise FactoryError(f"{path}: its columns differ from those of {self.shards[0][1]}")
            yield split, path, rows

    def names(self) -> Iterator[SampleName]:
        """Every sample, in order."""
        for split, path, rows in self.tables():
            for row, record in enumerate(rows):
                location, scene, frame = (
                    record[key].decode() for key in ("location", "scene", "frame")
                )
                variant = int(record["variant"])
                yield SampleName(path, row, split, location, scene, frame, variant)

    def samples(self, split: str) -> Iterator[Sample]:
        """Every sample of one split; one image of each layer is in memory at a time."""
        number = 0
        for _, path, count in (shard for shard in self.shards if shard[0] == split):
            with reading(path) as file:
                stacks = {name: ImageStack(stack) for name, stack in self._stacks(file)}
                table = file["meta"][()]
                for row in range(count):
                    images = {name: stack[row] for name, stack in stacks.items()}
                    yield Sample(split, number, images, _record(table[row]))
                    number += 1

    def _stacks(self, file: h5py.File) -> Iterator[tuple[str, h5py.Dataset]]:
        """Names and stacks of a shard that has the layers of the first."""
        found = _stacks(file)
        if {name: stack.dtype for name, stack in found.items()} != dict(self.layers):
            raise FactoryError(
                f"its layers ({', '.join(found)}) are not those of the other shards "
                f"({', '.join(self.layers)}); make the dataset again"
            )
        yield from found.items()


def open_source(directory: Path, split: Split, *, trusted: bool = False) -> Source:
    """Open a dataset folder.  Raises FactoryError when it is none or cannot be read.

    trusted: as in `shard_paths`.
    """
    return open_shards(directory, shard_paths(directory, split, trusted=trusted))


def open_shards(directory: Path, paths: Sequence[Path]) -> Source:
    """Open some shards of one dataset, at least one, that were checked.

    Raises FactoryError when one cannot be read.
    """
    with reading(paths[0]) as file:
        first = _describe(directory, file)
    shards: list[tuple[str, Path, int]] = []
    for path in paths:
        with reading(path) as file:
            sizes = {name: stack.shape[1:] for name, stack in _stacks(file).items()}
            if any(first.sizes.get(name, size) != size for name, size in sizes.items()):
                raise FactoryError("its images differ in size from the other shards'")
            shards.append((str(file.attrs["split"]), path, len(file["noisy"])))
    return replace(first, shards=tuple(shards))


def dataset_settings(directory: Path) -> dict[str, object]:
    """The `dataset` block of config.yaml; empty when there is none.

    Raises FactoryError when the file cannot be read, or when name or licence are not what the
    settings allow: both go into the cards of exports.
    """
    path = directory / CONFIG_NAME
    try:
        values = load_yaml(path)
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise FactoryError(
            f"{path}: cannot be read ({one_line(error)}); restore or delete it"
        ) from error
    block = values.get("dataset") if isinstance(values, dict) else None
    block = block if isinstance(block, dict) else {}
    name, licence = block.get("name") or "dataset", block.get("licence")
    if not (isinstance(name, str) and DATASET_NAME.fullmatch(name)):
        raise FactoryError(
            f"{path}: dataset.name {str(name)[:40]!r} is not letters, digits, dot, dash, underscore"
        )
    if not isinstance(licence, str | None):
        raise FactoryError(f"{path}: dataset.licence {str(licence)[:40]!r} must be text")
    return block


def json_record(record: Mapping[str, Value]) -> dict[str, Value | None]:
    """A record as strict JSON can hold it: a parameter that was not drawn (NaN) is null."""
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in record.items()
    }


def _describe(directory: Path, file: h5py.File) -> Source:
    table, stacks = file["meta"], _stacks(file)

    def about(name: str, key: str) -> str:
        return str(table.attrs.get(f"{name}.{key}", ""))

    return Source(
        directory,
        (),
        {name: stack.dtype for name, stack in stacks.items()},
        {name: stack.shape[1:] for name, stack in stacks.items()},
        tuple(
            Column(name, table.dtype[name].str, about(name, "units"), about(name, "description"))
            for name in table.dtype.names
        ),
        image_axes(file["noisy"]),
        config_of(file),
        str(file.attrs["config_hash"]),
        table.dtype,
    )


def _stacks(file: h5py.File) -> dict[str, h5py.Dataset]:
    """The image stacks of a shard by name, the core ones first.

    Only those that the schema knows and `reading` has checked: anything else in a stranger's file
    could lead out of it.
    """
    return {name.replace("/", "_"): file[name] for name in (*CORE, *optional_layers(file))}


def _record(row: np.void) -> dict[str, Value]:
    values = {name: row[name].item() for name in row.dtype.names or ()}
    return {name: v.decode() if isinstance(v, bytes) else v for name, v in values.items()}
