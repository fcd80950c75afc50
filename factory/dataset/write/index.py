"""index.h5: all shards of a dataset as one file, by virtual datasets with relative paths.

A convenience for those who have h5py alone: `index["train/noisy"][12345]`.  HDF5 fills a shard
that is absent with zeros and says nothing, so whoever can should ask manifest.json first, as
`PairDataset` and `validate` do.  manifest.json has its SHA-256.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import h5py

from ...errors import FactoryError
from ...files import write_atomically
from ...labels import classes_of
from ..format.axes import image_axes
from ..format.layout import config_of, optional_layers
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
from ..read.reader import reading
from .writer import write_axis

# What every shard says in the same words; the index says it once.
_SHARED_ATTRIBUTES = tuple(name for name in ROOT_ATTRIBUTES if name not in ("split", *SEALS))


def write_index(directory: Path, manifest: Manifest) -> Path:
    """Write index.h5 for the shards of `manifest` and return its path; equal input, equal bytes.

    manifest.json is saved with its SHA-256.
    The shards are of one configuration or were compared (`merge`), so the first shows the form of
    all.  Raises FactoryError when there is no shard, or the first cannot be read.
    """
    if not manifest.shards:
        raise FactoryError(f"{directory}: the dataset has no samples to index")
    with (
        reading(directory / min(manifest.shards)) as first,
        h5py.File(
            INDEX_NAME, "w", driver="core", backing_store=False, libver=LIBRARY_VERSIONS
        ) as index,
    ):
        _write_shared(index, first, manifest)
        for split in SPLITS:
            if shards := manifest.of_split(split):
                _write_split(index, split, shards, first)
        index.flush()
        content = index.id.get_file_image()
    path = directory / INDEX_NAME
    write_atomically(path, content)
    save_manifest(directory, replace(manifest, index_sha256=hashlib.sha256(content).hexdigest()))
    return path


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
    index: h5py.File, split: str, shards: Sequence[ShardInfo], first: h5py.File
) -> None:
    axes = image_axes(first["noisy"])
    classes = classes_of(config_of(first))
    for layer in layers(str(first["noisy"].dtype), optional_layers(first), classes):
        stack = _virtual(index, split, first[layer.name], shards)
        for key, value in layer_attributes(layer).items():
            stack.attrs[key] = value
        for dimension, label in enumerate((SAMPLE_DIMENSION, *layer.of_camera)):
            stack.dims[dimension].label = label
        for dimension, axis in enumerate(() if layer.of_camera else axes, start=1):
            stack.dims[dimension].label = axis.name
            stack.dims[dimension].attach_scale(index[f"axes/{axis.name}"])
    table = _virtual(index, split, first["meta"], shards)
    for key, value in dict(first["meta"].attrs).items():
        table.attrs[key] = value


def _virtual(
    index: h5py.File, split: str, like: h5py.Dataset, shards: Sequence[ShardInfo]
) -> h5py.Dataset:
    """A dataset put together of that of each shard.

    By h5py's lower floor, where a time stamp can be left out and one extent serves all shards of a
    size: h5py.VirtualLayout takes ten times as long.
    """
    name, shape = str(like.name).lstrip("/"), like.shape[1:]
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
    kind = h5py.h5t.py_create(like.dtype, logical=True)
    return h5py.Dataset(h5py.h5d.create(parent.id, own.encode(), kind, place, dcpl=layout))
