"""Writes shards: pairs in, an HDF5 file out whose bytes depend on the pairs alone; and index.h5.

index.h5 is for those who have h5py alone.  It holds the pairs of small datasets once more, as
`index["train/noisy"][12345]`, and links to the shards of large ones.  It has no virtual datasets,
because HDF5 silently fills these with zeros wherever it cannot open a shard: one that is absent or
may not be read, or more shards than the system lets a process open.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import string_dtype
from isal import isal_zlib

from ..common.array_types import Array
from ..common.errors import FrameError
from ..common.files import explain_os_errors, write_atomically
from .layout import config_of, crc32, image_axes, optional_layers, write_checksums
from .manifest import INDEX_NAME, Manifest, ShardInfo, save_manifest
from .meaning import classes_of
from .reader import reading
from .schema import (
    ROOT_ATTRIBUTES,
    SEALS,
    SPLITS,
    Axis,
    Column,
    Layer,
    Pair,
    Provenance,
    check_pair,
    config_text,
    layers,
    root_attributes,
    stored_image,
)
from .settings import DatasetSettings

_MOST_JOINED_BYTES = 1 << 28
"""Size of a dataset up to which index.h5 holds its pairs once more, some 4,000 of usual size."""
# Weights of the sums of Fletcher's checksum, for a piece of this many words.
_WEIGHTS = np.arange(1 << 16, 0, -1, dtype=np.float64)


def _file_in_memory() -> h5py.File:
    """A file that goes to disk in one write, so that its SHA-256 costs no second read.

    HDF5, which cannot close a file on a full disk, never touches the disk.
    """
    # Readable by every HDF5 since 1.10 (2016), and the same bytes whatever newer library writes.
    versions = ("v108", "v110")
    return h5py.File(
        "new.h5", "w", driver="core", backing_store=False, block_size=1 << 20, libver=versions
    )


def write_shard(
    root: Path,
    relative: str,
    pairs: Iterable[Pair],
    axes: tuple[Axis, Axis],
    columns: tuple[Column, ...],
    provenance: Provenance,
    settings: DatasetSettings,
) -> ShardInfo | None:
    """Write `pairs` to `root/relative` (for example train/shard-00000.h5), whole or not at all.

    `pairs` may be a generator: each pair is compressed as it comes and then forgotten.  Without
    any pair no file is written and None is returned.

    Raises FrameError for a pair that does not fit the axes or columns, FactoryError when the disk
    is full or the folder is not writable.
    """
    split = relative.split("/")[0]
    rows: list[tuple[Any, ...]] = []
    sums: dict[str, list[int]] = {}
    stacks: dict[Layer, h5py.Dataset] = {}
    with _file_in_memory() as file:
        for pair in pairs:
            name = f"{relative} sample {len(rows)}"
            row = check_pair(pair, axes, columns, name)
            wanted = layers(settings.dtype, pair.layers, classes_of(provenance.config))
            if not rows:
                shapes = {layer: pair.image(layer.name).shape for layer in wanted}
                stacks = _create_stacks(file, axes, shapes, settings)
            elif tuple(stacks) != wanted:
                raise FrameError(f"{name}: has other layers than the samples before it")
            rows.append(row)
            for layer, stack in stacks.items():
                stack.resize(len(rows), axis=0)
                image = pair.image(layer.name)
                if image.shape != stack.shape[1:]:
                    raise FrameError(f"{name}: {layer.name} has another size than before it")
                if layer.grey:
                    image = stored_image(image, layer.dtype)
                sums.setdefault(layer.name, []).append(crc32(image))
                if settings.compression == "gzip":
                    _write_gzip_chunk(stack, len(rows) - 1, image, settings.compression_level)
                else:
                    stack[-1] = image
        if not rows:
            return None
        _write_table(file, rows, columns)
        file.attrs.update(root_attributes(provenance, split, settings.dtype))
        write_checksums(file, sums)
        file.flush()
        content = file.id.get_file_image()
    path = root / relative
    with explain_os_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)
    sha256 = hashlib.sha256(content).hexdigest()
    return ShardInfo(relative, split, len(rows), len(content), sha256)


def _write_table(
    file: h5py.File, rows: Sequence[tuple[Any, ...]], columns: Sequence[Column]
) -> None:
    """Write the sample table `/meta` with units and descriptions."""
    types = ((column.name, np.dtype(column.dtype)) for column in columns)
    fields = [
        (name, string_dtype("utf-8", kind.itemsize) if kind.kind == "S" else kind)
        for name, kind in types
    ]
    table = file.create_dataset("meta", data=np.array(rows, dtype=fields), track_times=False)
    for column in columns:
        table.attrs[f"{column.name}.units"] = column.units
        table.attrs[f"{column.name}.description"] = column.description


def _create_stacks(
    file: h5py.File,
    axes: tuple[Axis, Axis],
    shapes: Mapping[Layer, tuple[int, ...]],
    settings: DatasetSettings,
) -> dict[Layer, h5py.Dataset]:
    """Empty, growing image stacks with their axes attached.  shapes: layer -> of its images."""
    for axis in axes:
        _write_axis(file, axis)
    filters: dict[str, Any] = {}
    if settings.compression == "gzip":
        level = settings.compression_level
        filters = {"fletcher32": True, "compression": "gzip", "compression_opts": level}
    stacks = {}
    for layer, shape in shapes.items():
        stacks[layer] = file.create_dataset(
            layer.name,
            shape=(0, *shape),
            maxshape=(None, *shape),
            dtype=layer.dtype,
            chunks=(1, *shape),
            track_times=False,
            **filters,
        )
        _describe(stacks[layer], layer, axes)
    return stacks


def _write_axis(file: h5py.File, axis: Axis) -> None:
    """Write an axis as a dimension scale, ready to be attached."""
    values = np.asarray(axis.values, dtype=np.float64)
    scale = file.create_dataset(f"axes/{axis.name}", data=values, track_times=False)
    scale.make_scale(axis.name)
    scale.attrs["units"] = axis.units
    scale.attrs["description"] = axis.description


def _describe(stack: h5py.Dataset, layer: Layer, axes: tuple[Axis, Axis]) -> None:
    """Attributes and dimensions of an image stack; its axes are in the file."""
    stack.attrs.update(layer.attributes())
    for dimension, label in enumerate(("sample", *layer.of_camera)):
        stack.dims[dimension].label = label
    for dimension, axis in enumerate(() if layer.of_camera else axes, start=1):
        stack.dims[dimension].label = axis.name
        stack.dims[dimension].attach_scale(stack.file[f"axes/{axis.name}"])


def _write_gzip_chunk(stack: h5py.Dataset, number: int, image: Array, level: int) -> None:
    """Store an image as chunk `number` of a stack that has gzip and fletcher32 as its filters.

    HDF5's own deflate costs as much as forming the image.  ISA-L makes the same format, as small,
    seven times faster; HDF5 only stores what comes of it, and every reader opens it.
    """
    plain = np.ascontiguousarray(image).data
    # The same on every processor since SSE4.2 (2008); of isal's levels 1 alone is like zlib's.
    content = (isal_zlib if level == 1 else zlib).compress(plain, level)
    offset = (number, *(0 for _ in image.shape))
    stack.id.write_direct_chunk(offset, content + struct.pack("<I", _fletcher32(content)))


def _fletcher32(content: bytes) -> int:
    """HDF5's variant of Fletcher's checksum, which ends every chunk.

    Of big-endian 16-bit words w_1 .. w_n, an odd last byte being the upper half of one: the sums of
    w_i and of (n + 1 - i) w_i, each modulo 65535 where 0 stands for itself alone (H5checksum.c).
    """
    words = np.frombuffer(content + b"\0" * (len(content) % 2), ">u2").astype(np.float64)
    low = high = 0
    for start in range(0, len(words), len(_WEIGHTS)):
        piece = words[start : start + len(_WEIGHTS)]
        # Whole numbers below 2**53, so exact in any order.
        high += low * len(piece) + int((piece * _WEIGHTS[-len(piece) :]).sum())
        low += int(piece.sum())
    return _folded(high) << 16 | _folded(low)


def _folded(total: int) -> int:
    return (total - 1) % 65535 + 1 if total else 0


# --- index.h5


def write_index(directory: Path, manifest: Manifest) -> None:
    """Write index.h5 for the shards of `manifest`, and manifest.json with its SHA-256.

    The shards are of one configuration or were compared (`merge`), so the first shows the form of
    all.  Equal input gives equal bytes.  Raises FactoryError when a shard cannot be read.
    """
    total_bytes = sum(shard.bytes for shard in manifest.shards.values())
    with _file_in_memory() as index:
        with reading(directory / min(manifest.shards)) as first:
            # What every shard says in the same words is said once.
            shared = (name for name in ROOT_ATTRIBUTES if name not in ("split", *SEALS))
            index.attrs.update({name: first.attrs[name] for name in shared})
            known = layers(
                str(first["noisy"].dtype), optional_layers(first), classes_of(config_of(first))
            )
            if total_bytes <= _MOST_JOINED_BYTES:
                _create_joined(index, manifest, first, known)
        # A merged dataset is of another configuration than any of its shards.
        index.attrs["config_hash"] = manifest.config_hash
        index.attrs["config"] = config_text(manifest.config)
        if total_bytes <= _MOST_JOINED_BYTES:
            _copy_shards(index, directory, manifest, known)
        else:
            for shard in manifest.shards.values():
                # Relative to the folder of the index itself, so the dataset can be moved.
                name = shard.path.removesuffix(".h5")
                index[name] = h5py.ExternalLink(shard.path, "/")
        index.flush()
        content = index.id.get_file_image()
    write_atomically(directory / INDEX_NAME, content)
    save_manifest(directory, replace(manifest, index_sha256=hashlib.sha256(content).hexdigest()))


def _create_joined(
    index: h5py.File, manifest: Manifest, first: h5py.File, known: Sequence[Layer]
) -> None:
    """The layers and tables of the index, empty; those of one shard show their form."""
    axes = image_axes(first["noisy"])
    for axis in axes:
        _write_axis(index, axis)
    for split in SPLITS:
        count = manifest.samples(split)
        for layer in known if count else ():
            like = first[layer.name]
            stack = index.create_dataset(
                f"{split}/{layer.name}",
                shape=(count, *like.shape[1:]),
                dtype=like.dtype,
                chunks=like.chunks,
                track_times=False,
                **_filters_of(like),
            )
            _describe(stack, layer, axes)
        if count:
            kind = first["meta"].dtype
            table = index.create_dataset(f"{split}/meta", (count,), kind, track_times=False)
            table.attrs.update(first["meta"].attrs)


def _copy_shards(
    index: h5py.File, directory: Path, manifest: Manifest, known: Sequence[Layer]
) -> None:
    """Copy the layers and tables of all shards, in the order of their names."""
    for split in SPLITS:
        start = 0
        for shard in manifest.of_split(split):
            with reading(directory / shard.path) as file:
                index[f"{split}/meta"][start : start + shard.samples] = file["meta"][()]
                for layer in known:
                    _copy_images(file[layer.name], index[f"{split}/{layer.name}"], start)
            start += shard.samples


def _filters_of(stack: h5py.Dataset) -> dict[str, Any]:
    return {
        "fletcher32": stack.fletcher32,
        "compression": stack.compression,
        "compression_opts": stack.compression_opts,
    }


def _copy_images(source: h5py.Dataset, target: h5py.Dataset, start: int) -> None:
    """Copy images, a chunk each, behind the first `start` ones of another dataset."""
    if _filters_of(source) != _filters_of(target):
        target[start : start + len(source)] = source[()]
        return
    corner = (0,) * (source.ndim - 1)
    for number in range(len(source)):
        mask, content = source.id.read_direct_chunk((number, *corner))
        target.id.write_direct_chunk((start + number, *corner), content, mask)
