"""index.h5: all shards of a dataset as one file, by virtual datasets with relative paths.

A convenience for those who have h5py alone: `index["train/noisy"][12345]`.  HDF5 fills a shard
that is absent with zeros and says nothing, so whoever can should ask manifest.json first, as
`PairDataset` and `validate` do.  manifest.json has its SHA-256.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py

from ...errors import FactoryError
from ...files import write_atomically
from ...storage.copies import url_of
from ..format.axes import dataset_inside, image_axes
from ..format.layout import optional_layers
from ..format.manifest import INDEX_NAME, Manifest, ShardInfo, save_manifest
from ..format.schema import (
    LIBRARY_VERSIONS,
    ROOT_ATTRIBUTES,
    SAMPLE_DIMENSION,
    SEALS,
    SPLITS,
    config_text,
    layer_attributes,
    layers,
)
from ..read.reader import bring, reading
from .writer import write_axis

# What every shard says in the same words; the index says it once.
_SHARED_ATTRIBUTES = tuple(name for name in ROOT_ATTRIBUTES if name not in ("split", *SEALS))

# Of each layer and of /meta: shape of a sample, and dtype.
_Form = Mapping[str, tuple[tuple[int, ...], Any]]


def write_index(directory: Path, manifest: Manifest) -> Path:
    """Write index.h5 for the shards of `manifest` and return its path; equal input, equal bytes.

    manifest.json is saved with its SHA-256.
    Raises FactoryError when there is no shard, one cannot be opened, or they differ in form; what
    else may be wrong with a shard is for those to find who read it.
    """
    if not manifest.shards:
        raise FactoryError(f"{directory}: the dataset has no samples to index")
    splits = {
        split: [s for _, s in sorted(manifest.shards.items()) if s.split == split]
        for split in SPLITS
    }
    example = directory / min(manifest.shards)
    with reading(example) as first:
        form = _form_of(first)
    for shards in splits.values():
        _check_alike(directory, shards, form)
    with (
        reading(example) as first,
        h5py.File(
            INDEX_NAME, "w", driver="core", backing_store=False, libver=LIBRARY_VERSIONS
        ) as index,
    ):
        _write_shared(index, first, manifest)
        for split, shards in splits.items():
            if shards:
                _write_split(index, split, shards, first, form)
        index.flush()
        content = index.id.get_file_image()
    path = directory / INDEX_NAME
    write_atomically(path, content)
    save_manifest(directory, replace(manifest, index_sha256=hashlib.sha256(content).hexdigest()))
    return path


def _form_of(file: h5py.File) -> _Form:
    """Of a shard; raises FactoryError for one whose data lie in another file."""
    names = [layer.name for layer in layers(str(file["noisy"].dtype), optional_layers(file))]
    stacks = {name: dataset_inside(file, name, chunks=True) for name in names}
    stacks["meta"] = dataset_inside(file, "meta")
    return {name: (stack.shape[1:], stack.dtype) for name, stack in stacks.items()}


def _check_alike(directory: Path, shards: Sequence[ShardInfo], form: _Form) -> None:
    """Every shard has the pictures and columns of the first, and its samples."""
    copied = url_of(directory)
    for shard in shards:
        path = directory / shard.path
        if copied:
            bring(path)
        try:
            # To check all that a shard says takes twenty times longer.
            with h5py.File(path, "r") as file:
                alike = _form_of(file) == form and len(file["noisy"]) == shard.samples
        except (ArithmeticError, LookupError, OSError, RuntimeError, TypeError, ValueError):
            alike = False
        except FactoryError:
            alike = False
        if not alike:
            raise FactoryError(
                f"{path}: cannot be read, or has other pictures or columns than the other shards; "
                "make the dataset again in an empty folder"
            )


def _write_shared(index: h5py.File, first: h5py.File, manifest: Manifest) -> None:
    """Attributes and axes."""
    for name in _SHARED_ATTRIBUTES:
        index.attrs[name] = first.attrs[name]
    # A merged dataset is of another configuration than any of its shards.
    index.attrs["config_hash"] = manifest.config_hash
    index.attrs["config"] = config_text(manifest.config)
    for axis in image_axes(first["noisy"]):
        write_axis(index, axis)


def _write_split(
    index: h5py.File, split: str, shards: Sequence[ShardInfo], first: h5py.File, form: _Form
) -> None:
    axes = image_axes(first["noisy"])
    for layer in layers(str(first["noisy"].dtype), optional_layers(first)):
        stack = _virtual(index, split, layer.name, shards, form)
        for key, value in layer_attributes(layer).items():
            stack.attrs[key] = value
        for dimension, label in enumerate((SAMPLE_DIMENSION, *layer.of_camera)):
            stack.dims[dimension].label = label
        for dimension, axis in enumerate(() if layer.of_camera else axes, start=1):
            stack.dims[dimension].label = axis.name
            stack.dims[dimension].attach_scale(index[f"axes/{axis.name}"])
    table = _virtual(index, split, "meta", shards, form)
    for key, value in dict(first["meta"].attrs).items():
        table.attrs[key] = value


def _virtual(
    index: h5py.File, split: str, name: str, shards: Sequence[ShardInfo], form: _Form
) -> h5py.Dataset:
    """A dataset put together of that of each shard.

    By h5py's lower floor, where a time stamp can be left out and one extent serves all shards of a
    size: h5py.VirtualLayout takes ten times as long.
    """
    shape, dtype = form[name]
    layout = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    layout.set_layout(h5py.h5d.VIRTUAL)
    layout.set_obj_track_times(False)
    place = h5py.h5s.create_simple((sum(shard.samples for shard in shards), *shape))
    whole: dict[int, h5py.h5s.SpaceID] = {}
    start, origin = 0, (0,) * len(shape)
    for shard in shards:
        size = (shard.samples, *shape)
        whole.setdefault(shard.samples, h5py.h5s.create_simple(size))
        place.select_hyperslab((start, *origin), size)
        # Relative to the folder of the index itself, so the dataset can be moved.
        layout.set_virtual(place, shard.path.encode(), name.encode(), whole[shard.samples])
        start += shard.samples
    place.select_all()
    group, _, own = f"{split}/{name}".rpartition("/")
    parent = index.require_group(group)
    kind = h5py.h5t.py_create(dtype, logical=True)
    return h5py.Dataset(h5py.h5d.create(parent.id, own.encode(), kind, place, dcpl=layout))
