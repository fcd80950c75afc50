"""index.h5: all shards of a dataset as one file, by virtual datasets with relative paths.

A convenience for those who have h5py alone: `index["train/noisy"][12345]`.  HDF5 fills a shard
that is absent with zeros and says nothing, so whoever can should ask manifest.json first, as
`PairDataset` and `validate` do.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ...errors import FactoryError
from ...files import write_atomically
from ...storage.copies import url_of
from ..format.axes import image_axes
from ..format.layers import EFFECT_FOLDER, layers
from ..format.layout import optional_layers
from ..format.manifest import INDEX_NAME, Manifest, ShardInfo
from ..format.schema import (
    LIBRARY_VERSIONS,
    ROOT_ATTRIBUTES,
    SAMPLE_DIMENSION,
    SEALS,
    SPLITS,
    config_text,
    layer_attributes,
)
from ..read.reader import bring, reading
from .virtual import VirtualStacks
from .writer import write_axis

# Of metadata that HDF5 keeps in memory: a virtual dataset kept there takes 4 kB a shard, closed or
# not.
_CACHE_BYTES = 1 << 20

# What every shard says in the same words; the index says it once.
_SHARED_ATTRIBUTES = tuple(name for name in ROOT_ATTRIBUTES if name not in ("split", *SEALS))


def write_index(directory: Path, manifest: Manifest) -> Path:
    """Write index.h5 for the shards of `manifest` and return its path; equal input, equal bytes.

    Raises FactoryError when there is no shard, one cannot be opened, or they differ in form; what
    else may be wrong with a shard is for those to find who read it.
    """
    if not manifest.shards:
        raise FactoryError(f"{directory}: the dataset has no samples to index")
    with h5py.File(
        INDEX_NAME, "w", driver="core", backing_store=False, libver=LIBRARY_VERSIONS
    ) as index:
        _keep_little(index)
        first = _Form.of(directory, min(manifest.shards))
        stacks = VirtualStacks(index)
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
                _write_split(index, stacks, directory, split, shards, first)
        index.flush()
        content = index.id.get_file_image()
    path = directory / INDEX_NAME
    write_atomically(path, stacks.filled(content))
    return path


def _keep_little(index: h5py.File) -> None:
    """Have HDF5 forget what is closed; what it writes is the same."""
    cache = index.id.get_mdc_config()
    cache.set_initial_size = True
    cache.initial_size = cache.min_size = cache.max_size = _CACHE_BYTES
    # Neither grow nor shrink (H5C_incr__off, H5C_flash_incr__off, H5C_decr__off).
    cache.incr_mode = cache.flash_incr_mode = cache.decr_mode = 0
    index.id.set_mdc_config(cache)


class _Form:
    """What the shards of a dataset have in common, read from one of them."""

    def __init__(self, file: h5py.File) -> None:
        noisy = file["noisy"]
        self.dtype = str(noisy.dtype)
        self.optional = optional_layers(file)
        self.table: np.dtype[Any] = file["meta"].dtype
        self.axes = image_axes(noisy)
        self.attributes: Mapping[str, Any] = dict(file.attrs)
        self.table_attributes: Mapping[str, Any] = dict(file["meta"].attrs)
        names = ["meta", *(layer.name for layer in layers(self.dtype, self.optional))]
        self.shapes = {name: file[name].shape[1:] for name in names}
        self._types = {name: file[name].id.get_type() for name in names}
        self._counts = _object_counts(file.id)

    @classmethod
    def of(cls, directory: Path, relative: str) -> _Form:
        with reading(directory / relative) as file:
            return cls(file)

    @property
    def comparable(self) -> tuple[object, ...]:
        return self.shapes, self.dtype, self.optional, self.table

    def fits(self, directory: Path, shard: ShardInfo) -> bool:
        """Whether a shard has the same pictures and columns; raises FactoryError when damaged."""
        # To look at all that a shard says takes twenty times longer: for the odd one.
        return self._plainly_fits(f"{directory}/{shard.path}", shard.samples) or (
            self.of(directory, shard.path).comparable == self.comparable
        )

    def _plainly_fits(self, path: str, samples: int) -> bool:
        if not os.path.isfile(path):
            return False
        try:
            # Closed as the last name of it goes, in half the time that its close() takes.
            file = h5py.h5f.open(os.fsencode(path), h5py.h5f.ACC_RDONLY)
            return _object_counts(file) == self._counts and all(
                _is_own(file, name)
                and self._is_alike(h5py.h5d.open(file, name.encode()), name, samples)
                for name in self._types
            )
        except (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError):
            return False

    def _is_alike(self, found: h5py.h5d.DatasetID, name: str, samples: int) -> bool:
        plist = found.get_create_plist()
        return (
            found.shape == (samples, *self.shapes[name])
            and found.get_type() == self._types[name]
            # The index must not lead out of the dataset by way of a shard.
            and plist.get_layout() != h5py.h5d.VIRTUAL
            and not plist.get_external_count()
        )


def _object_counts(file: h5py.h5f.FileID) -> tuple[int, int]:
    """Objects at the root of a shard, and in its folder of effects."""
    effects = EFFECT_FOLDER.rstrip("/")
    if not file.links.exists(effects.encode()):
        return file.get_num_objs(), 0
    inside = _is_own(file, effects) and h5py.h5g.open(file, effects.encode()).get_num_objs()
    return file.get_num_objs(), int(inside)


def _is_own(file: h5py.h5f.FileID, name: str) -> bool:
    """Whether no link on the way to `name` leads out; KeyError when there is nothing."""
    folder = name.rpartition("/")[0]
    steps = [step.encode() for step in (folder, name) if step]
    return all(file.links.get_info(at).type == h5py.h5l.TYPE_HARD for at in steps)


def _write_split(
    index: h5py.File,
    stacks: VirtualStacks,
    directory: Path,
    split: str,
    shards: Sequence[ShardInfo],
    first: _Form,
) -> None:
    copied = url_of(directory)
    for shard in shards:
        if copied:
            bring(directory / shard.path)
        if not first.fits(directory, shard):
            raise FactoryError(
                f"{directory / shard.path}: has other pictures or columns than the other shards; "
                "make the dataset again in an empty folder"
            )
    for layer in layers(first.dtype, first.optional):
        stack = stacks.add(
            f"{split}/{layer.name}",
            layer.name,
            shards,
            first.shapes[layer.name],
            np.dtype(layer.dtype),
        )
        for key, value in layer_attributes(layer).items():
            stack.attrs[key] = value
        for dimension, label in enumerate((SAMPLE_DIMENSION, *layer.of_camera)):
            stack.dims[dimension].label = label
        for dimension, axis in enumerate(() if layer.of_camera else first.axes, start=1):
            stack.dims[dimension].label = axis.name
            stack.dims[dimension].attach_scale(index[f"axes/{axis.name}"])
        del stack  # before the next one is made
    table = stacks.add(f"{split}/meta", "meta", shards, (), first.table)
    for key, value in first.table_attributes.items():
        table.attrs[key] = value
