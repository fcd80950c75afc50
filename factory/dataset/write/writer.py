"""Writes one shard: pairs in, an HDF5 file out whose bytes depend on the pairs alone."""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
from isal import isal_zlib

from ...errors import FrameError
from ...files import explain_os_errors, write_atomically
from ...labels import classes_of
from ..format.checksums import crc32, write_checksums
from ..format.manifest import ShardInfo
from ..format.schema import (
    LIBRARY_VERSIONS,
    SAMPLE_DIMENSION,
    Axis,
    Column,
    Layer,
    Pair,
    Provenance,
    check_pair,
    image_of,
    layer_attributes,
    layers,
    root_attributes,
    stored_image,
    stores_grey,
    table_dtype,
)
from ..format.settings import DatasetSettings

_IMAGE_BLOCK_BYTES = 1 << 20
# What isal calls levels are others than zlib's, but these two are alike in size.
_ISAL_LEVEL = 1
# Of the sums of Fletcher's checksum, for a piece of so many words.
_WEIGHTS = np.arange(1 << 16, 0, -1, dtype=np.float64)


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
    dtype = table_dtype(columns)
    # The file is made in memory: it goes to disk in one write, its SHA-256 costs no second read,
    # and HDF5, which cannot close a file on a full disk, never touches the disk.
    with h5py.File(
        "shard.h5",
        "w",
        driver="core",
        backing_store=False,
        block_size=_IMAGE_BLOCK_BYTES,
        libver=LIBRARY_VERSIONS,
    ) as file:
        stacks: dict[Layer, h5py.Dataset] = {}
        for pair in pairs:
            name = f"{relative} sample {len(rows)}"
            row = check_pair(pair, axes, columns, name)
            wanted = layers(settings.dtype, pair.layers, classes_of(provenance.config))
            if not rows:
                shapes = {layer: image_of(pair, layer.name).shape for layer in wanted}
                stacks = _create_stacks(file, axes, shapes, settings)
            elif tuple(stacks) != wanted:
                raise FrameError(f"{name}: has other layers than the samples before it")
            rows.append(row)
            for layer, stack in stacks.items():
                stack.resize(len(rows), axis=0)
                image = image_of(pair, layer.name)
                if image.shape != stack.shape[1:]:
                    raise FrameError(f"{name}: {layer.name} has another size than before it")
                if stores_grey(layer):
                    image = stored_image(image, layer.dtype)
                sums.setdefault(layer.name, []).append(crc32(image))
                if settings.compression == "gzip":
                    write_gzip_chunk(stack, len(rows) - 1, image, settings.compression_level)
                else:
                    stack[-1] = image
        if not rows:
            return None
        _write_table(file, np.array(rows, dtype=dtype), columns)
        for key, value in root_attributes(provenance, split, settings.dtype).items():
            file.attrs[key] = value
        write_checksums(file, sums)
        file.flush()
        content = file.id.get_file_image()
    path = root / relative
    with explain_os_errors(path.parent):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)
    return ShardInfo(
        path=relative,
        split=split,
        samples=len(rows),
        bytes=len(content),
        sha256=hashlib.sha256(content).hexdigest(),
    )


def _create_stacks(
    file: h5py.File,
    axes: tuple[Axis, Axis],
    shapes: Mapping[Layer, tuple[int, ...]],
    settings: DatasetSettings,
) -> dict[Layer, h5py.Dataset]:
    """Empty, growing image stacks with their axes attached.  shapes: layer -> of its pictures."""
    scales = [write_axis(file, axis) for axis in axes]
    filters: dict[str, Any] = {}
    if settings.compression == "gzip":
        level = settings.compression_level
        filters = {"fletcher32": True, "compression": "gzip", "compression_opts": level}
    stacks = {}
    for layer, shape in shapes.items():
        stack = file.create_dataset(
            layer.name,
            shape=(0, *shape),
            maxshape=(None, *shape),
            dtype=layer.dtype,
            chunks=(1, *shape),
            track_times=False,
            **filters,
        )
        for key, value in layer_attributes(layer).items():
            stack.attrs[key] = value
        for dimension, label in enumerate((SAMPLE_DIMENSION, *layer.of_camera)):
            stack.dims[dimension].label = label
        if not layer.of_camera:
            for dimension, (axis, scale) in enumerate(zip(axes, scales, strict=True), start=1):
                stack.dims[dimension].label = axis.name
                stack.dims[dimension].attach_scale(scale)
        stacks[layer] = stack
    return stacks


def write_axis(file: h5py.File, axis: Axis) -> h5py.Dataset:
    """Write an axis as a dimension scale, ready to be attached, and return it."""
    values = np.asarray(axis.values, dtype=np.float64)
    scale = file.create_dataset(f"axes/{axis.name}", data=values, track_times=False)
    scale.make_scale(axis.name)
    scale.attrs["units"] = axis.units
    scale.attrs["description"] = axis.description
    return scale


def _write_table(file: h5py.File, rows: np.ndarray[Any, Any], columns: tuple[Column, ...]) -> None:
    """/meta, one row a sample; units and meaning of every column are attributes beside it."""
    table = file.create_dataset("meta", data=rows, track_times=False)
    for column in columns:
        table.attrs[f"{column.name}.units"] = column.units
        table.attrs[f"{column.name}.description"] = column.description


def write_gzip_chunk(
    stack: h5py.Dataset, number: int, image: npt.NDArray[np.generic], level: int
) -> None:
    """Store an image as chunk `number` of a stack that has gzip and fletcher32 as its filters.

    HDF5's own deflate costs as much as forming the picture.  ISA-L makes the same format, as small,
    seven times faster; HDF5 only stores what comes of it, and every reader opens it.
    image: of the stack's dtype and the shape of one chunk.  level: of gzip, 0 to 9.
    """
    content = deflate(np.ascontiguousarray(image), level)
    offset = (number, *(0 for _ in image.shape))
    stack.id.write_direct_chunk(offset, content + struct.pack("<I", fletcher32(content)))


def deflate(image: npt.NDArray[np.generic], level: int) -> bytes:
    """The zlib stream of an image's bytes: the same on every processor since SSE4.2 (2008)."""
    if level == _ISAL_LEVEL:
        return isal_zlib.compress(image.data, level)
    return zlib.compress(image.data, level)


def fletcher32(content: bytes) -> int:
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
