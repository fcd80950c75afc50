"""index.h5: all shards of a dataset as one file, by virtual datasets with relative paths.

A convenience for those who have h5py alone: `index["train/noisy"][12345]`.  HDF5 fills a shard
that is absent with zeros and says nothing, so whoever can should ask manifest.json first, as
`PairDataset` and `validate` do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from simnfnd.factory.dataset.format.axes import image_axes
from simnfnd.factory.dataset.format.layout import optional_layers
from simnfnd.factory.dataset.format.manifest import INDEX_NAME, Manifest, ShardInfo
from simnfnd.factory.dataset.format.schema import (
    LIBRARY_VERSIONS,
    ROOT_ATTRIBUTES,
    SAMPLE_DIMENSION,
    SEALS,
    SPLITS,
    config_text,
    layer_attributes,
    layers,
)
from simnfnd.factory.dataset.read.reader import reading
from simnfnd.factory.dataset.write.writer import write_axis
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import write_atomically

# What every shard says in the same words; the index says it once.
_SHARED_ATTRIBUTES = tuple(name for name in ROOT_ATTRIBUTES if name not in ("split", *SEALS))


def write_index(directory: Path, manifest: Manifest) -> Path:
    """Write index.h5 for the shards of `manifest` and return its path; equal input, equal bytes.

    Raises FactoryError when there is no shard, one is damaged, or they differ in form.
    """
    if not manifest.shards:
        raise FactoryError(f"{directory}: the dataset has no samples to index")
    with h5py.File(
        INDEX_NAME, "w", driver="core", backing_store=False, libver=LIBRARY_VERSIONS
    ) as index:
        first = _Form.of(directory, min(manifest.shards))
        for name in _SHARED_ATTRIBUTES:
            index.attrs[name] = first.attributes[name]
        # A merged dataset is of another configuration than any of its shards.
        index.attrs["config_hash"] = manifest.config_hash
        index.attrs["config"] = config_text(manifest.config)
        for axis in first.axes:
            write_axis(index, axis)
        for split in SPLITS:
            shards = [s for _, s in sorted(manifest.shards.items()) if s.split == split]
            if shards:
                _write_split(index, directory, split, shards, first)
        index.flush()
        content = index.id.get_file_image()
    path = directory / INDEX_NAME
    write_atomically(path, content)
    return path


class _Form:
    """What the shards of a dataset have in common, read from one of them."""

    def __init__(self, file: h5py.File) -> None:
        noisy = file["noisy"]
        self.shape: tuple[int, int] = noisy.shape[1:]
        self.dtype = str(noisy.dtype)
        self.optional = optional_layers(file)
        self.table: np.dtype[Any] = file["meta"].dtype
        self.axes = image_axes(noisy)
        self.attributes: Mapping[str, Any] = dict(file.attrs)
        self.table_attributes: Mapping[str, Any] = dict(file["meta"].attrs)

    @classmethod
    def of(cls, directory: Path, relative: str) -> _Form:
        with reading(directory / relative) as file:
            return cls(file)

    @property
    def comparable(self) -> tuple[object, ...]:
        return self.shape, self.dtype, self.optional, self.table


def _write_split(
    index: h5py.File, directory: Path, split: str, shards: Sequence[ShardInfo], first: _Form
) -> None:
    for shard in shards:
        if _Form.of(directory, shard.path).comparable != first.comparable:
            raise FactoryError(
                f"{directory / shard.path}: has other pictures or columns than the other shards; "
                "make the dataset again in an empty folder"
            )
    for layer in layers(first.dtype, first.optional):
        stack = _virtual(
            index, f"{split}/{layer.name}", layer.name, shards, first.shape, np.dtype(layer.dtype)
        )
        for key, value in layer_attributes(layer).items():
            stack.attrs[key] = value
        stack.dims[0].label = SAMPLE_DIMENSION
        for dimension, axis in enumerate(first.axes, start=1):
            stack.dims[dimension].label = axis.name
            stack.dims[dimension].attach_scale(index[f"axes/{axis.name}"])
    table = _virtual(index, f"{split}/meta", "meta", shards, (), first.table)
    for key, value in first.table_attributes.items():
        table.attrs[key] = value


def _virtual(
    index: h5py.File,
    name: str,
    source: str,
    shards: Sequence[ShardInfo],
    shape: tuple[int, ...],
    dtype: np.dtype[Any],
) -> h5py.Dataset:
    layout = h5py.VirtualLayout((sum(s.samples for s in shards), *shape), dtype)
    start = 0
    for shard in shards:
        # Relative to the folder of the index itself, so the dataset can be moved.
        layout[start : start + shard.samples] = h5py.VirtualSource(
            shard.path, source, (shard.samples, *shape), dtype
        )
        start += shard.samples
    layout.dcpl.set_obj_track_times(False)
    return index.create_virtual_dataset(name, layout)
