"""Checks that a shard is laid out as the schema says, is whole, and refers to no other file.

A dataset may be untrusted or lie on a failing disk.  The checks read no image: they cover links,
types, sizes, filters and attributes.  A file that passes names no other file and has one chunk per
image.  HDF5 has no checksums for contiguous datasets (/meta, /axes, uncompressed images), for
texts, and for the tables that say where a chunk lies.  Therefore a shard has

- `/checksums`, one row per sample and one column per layer: CRC-32 of the image's bytes;
- the root attributes `checksum`, of the other root attributes, /meta, the axes and `/checksums`,
  and `text_checksum`, of the attributes of layers, columns and axes: BLAKE2b (16 bytes,
  hexadecimal) of a JSON text that `_contents` and `_texts` write.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from itertools import accumulate, chain
from math import prod
from typing import Any

import h5py
import numpy as np

from ..common.array_types import Array
from ..common.errors import FactoryError
from ..common.small_files import parse_json
from .schema import (
    CAMERA_LAYERS,
    CHECKSUMS,
    CORE,
    EFFECT_FOLDER,
    OPTIONAL_LAYERS,
    REQUIRED_COLUMNS,
    ROOT_ATTRIBUTES,
    SCHEMA,
    SEALS,
    SPLITS,
    VALUE_RANGES,
    Axis,
    Layer,
    layers,
)

DEFLATE: Any = zlib
with suppress(ImportError):
    DEFLATE = import_module("isal.isal_zlib")
"""isal's zlib, in a third to two thirds of the time; readers may have numpy and h5py alone."""

# --- what lies in the file itself


def exists(file: h5py.File, name: str) -> bool:
    """Whether there is a link of that name, whatever it leads to."""
    return bool(file.id.links.exists(name.encode()))


def object_inside(file: h5py.File, name: str) -> Any:
    """The object at `name`; links that could lead out of the file are refused on the way."""
    for part in accumulate(name.split("/"), "{}/{}".format):
        if not exists(file, part):
            raise FactoryError(f"dataset /{part} is absent; generate the shard again")
        # Not h5py's own `in` and `get`: they open the file that an external link names.
        if file.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
            raise FactoryError(f"/{part} is a link to elsewhere; not followed")
    return file[name]


def dataset_inside(file: h5py.File, name: str, *, chunks: bool = False) -> h5py.Dataset:
    """A dataset that lies in this very file, in one piece or in chunks as the schema has it.

    What lies in one piece is read as a whole, so it may not claim more bytes than the file has.
    """
    dataset = object_inside(file, name)
    if not isinstance(dataset, h5py.Dataset):
        raise FactoryError(f"/{name} is no dataset; generate the shard again")
    plist = dataset.id.get_create_plist()
    if plist.get_layout() == h5py.h5d.VIRTUAL or plist.get_external_count():
        raise FactoryError(f"/{name} keeps its data in another file; not followed")
    if chunks != (plist.get_layout() == h5py.h5d.CHUNKED):
        storage = "chunks" if chunks else "one piece"
        raise FactoryError(f"/{name}: the schema keeps it in {storage}; generate it again")
    claimed = int(np.prod(dataset.shape, dtype=np.float64)) * dataset.id.get_type().get_size()
    if not chunks and claimed > file.id.get_filesize():
        raise FactoryError(f"/{name} claims more bytes than the file has")
    return dataset


def image_axes(stack: h5py.Dataset) -> tuple[Axis, Axis]:
    """Row and column axes of an image stack.  Raises FactoryError when one cannot be read."""
    return _axis(stack, 1), _axis(stack, 2)


def _axis(stack: h5py.Dataset, dimension: int) -> Axis:
    # The axis is found by its name: HDF5 crashes on some numbers in place of a reference.
    name = str(stack.dims[dimension].label)
    size = stack.shape[dimension]
    scale = dataset_inside(stack.file, f"axes/{name}")
    if scale.shape != (size,) or scale.dtype.kind not in "iuf":
        raise FactoryError(f"/axes/{name} does not have the {size} numbers of {stack.name}")
    units, about = (str(scale.attrs.get(key, "")) for key in ("units", "description"))
    return Axis(name, units, scale[()].astype(np.float64), about)


def optional_layers(file: h5py.File) -> tuple[str, ...]:
    """Names of the optional layers that a shard has, in the order of the schema."""
    names = [layer.name for layer in OPTIONAL_LAYERS if exists(file, layer.name)]
    if exists(file, folder := EFFECT_FOLDER.rstrip("/")):
        group = object_inside(file, folder)
        if not isinstance(group, h5py.Group):
            raise FactoryError(f"/{folder} is no group of layers")
        names += [f"{EFFECT_FOLDER}{name}" for name in sorted(group)]
    return tuple(names)


def config_of(file: h5py.File) -> dict[str, Any]:
    """The settings that a shard states in its `config` attribute.

    Raises FactoryError (without the file's name) when they are absent or damaged.
    """
    config = None
    with suppress(ValueError):
        config = parse_json(_text_attribute(file, "config"))
    if not isinstance(config, dict):
        raise FactoryError("attribute config is no JSON object; generate the shard again")
    return config


# --- what the schema says# --- what the schema says


def check_shard(file: h5py.File) -> None:
    """Raise FactoryError (without the file's name) with what keeps an open shard from being read.

    Other exceptions can escape from HDF5 itself when the file is damaged.
    """
    allowed = {"schema": (SCHEMA,), "split": SPLITS, "generator": (), "config_hash": ()}
    for name, values in allowed.items():
        text = _text_attribute(file, name)
        if values and text not in values:
            raise FactoryError(
                f"attribute {name} {text[:40]!r}: this program reads {' or '.join(values)}; use "
                "a matching release"
            )
    config_of(file)
    noisy = dataset_inside(file, "noisy", chunks=True)
    shape = noisy.shape
    dtype = str(noisy.dtype)
    if len(shape) != 3 or dtype not in VALUE_RANGES:
        raise FactoryError(
            f"/noisy is {shape} {dtype}; expected samples, rows and columns of "
            f"{' or '.join(VALUE_RANGES)}"
        )
    for layer in layers(dtype, optional_layers(file)):
        stack = dataset_inside(file, layer.name, chunks=True)
        _check_stack(stack, layer, shape)
        _check_chunks(stack)
    _check_table(dataset_inside(file, "meta"), shape[0])
    _check_contents(file)


def _check_stack(stack: h5py.Dataset, layer: Layer, shape: tuple[int, ...]) -> None:
    """A stack has the shape, type and chunks of its layer.  shape: of /noisy."""
    samples, *image_shape = stack.shape or (-1,)
    problem = layer.size_problem(tuple(image_shape), shape[1:])
    if samples != shape[0]:
        problem = f"has {samples} images, /noisy {shape[0]}"
    # The type must be that of the layer in other shards, too.
    elif str(stack.dtype) != layer.dtype or stack.chunks != (1, *image_shape):
        problem = problem or (
            f"is {stack.dtype} in chunks {stack.chunks}; expected {layer.dtype}, one chunk "
            "for each image"
        )
    if problem:
        raise FactoryError(f"/{layer.name} {problem}")


def _check_chunks(stack: h5py.Dataset) -> None:
    """Each sample has a chunk inside the file; HDF5 aborts over sizes that cannot be."""
    name = stack.name
    (samples, *image_shape) = stack.shape
    filters = _filters(stack)
    ending = 4 if h5py.h5z.FILTER_FLETCHER32 in filters else 0
    full = prod(image_shape) * stack.dtype.itemsize + ending
    least = most = full
    if h5py.h5z.FILTER_DEFLATE in filters:
        least = ending + 1
        # Incompressible data grow by far less than this.
        most = full + full // 16 + 4096
    file_bytes = stack.file.id.get_filesize()
    origin = (0,) * len(image_shape)
    chunk_count = 0

    def check_chunk(chunk: Any) -> None:
        nonlocal chunk_count
        is_next = chunk.chunk_offset == (chunk_count, *origin) and chunk_count < samples
        is_filtered = not chunk.filter_mask
        is_sized = chunk.byte_offset is not None and least <= chunk.size <= most
        if not (is_next and is_filtered and is_sized) or (
            chunk.byte_offset + chunk.size > file_bytes
        ):
            raise FactoryError(f"{name} sample {chunk_count}: damaged chunk; generate it again")
        chunk_count += 1

    stack.id.chunk_iter(check_chunk)
    if chunk_count != samples:
        raise FactoryError(f"{name} holds {chunk_count} of {samples} samples; generate it again")


def _filters(stack: h5py.Dataset) -> set[int]:
    """The filters of an image stack: none, gzip, Fletcher's checksum, or both.

    Any other would be a library that HDF5 loads from wherever HDF5_PLUGIN_PATH points, or let a
    chunk grow without bound.  Raises FactoryError for one.
    """
    plist = stack.id.get_create_plist()
    codes = [plist.get_filter(index)[0] for index in range(plist.get_nfilters())]
    known = [h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32]
    if codes not in ([], known[:1], known[1:], known):
        raise FactoryError(f"{stack.name} uses filters {codes}, which are not of {SCHEMA}")
    return set(codes)


def _check_table(table: h5py.Dataset, samples: int) -> None:
    """Raise FactoryError unless /meta has its rows and columns, of known types, in UTF-8."""
    names = table.dtype.names or ()
    if table.shape != (samples,) or not set(REQUIRED_COLUMNS).issubset(names):
        raise FactoryError(
            f"/meta must have {samples} rows with the columns {', '.join(REQUIRED_COLUMNS)}"
        )
    kinds = {name: table.dtype[name].kind for name in names}
    text = {kinds[name] for name in REQUIRED_COLUMNS[:3]}
    if not set(kinds.values()) <= set("iufS") or text != {"S"} or kinds["variant"] not in "iu":
        raise FactoryError("/meta has columns of types that the schema does not know")
    rows = table[()]
    try:
        for name in (name for name in names if kinds[name] == "S"):
            b" ".join(rows[name].tolist()).decode()  # as it is wherever it is shown
    except UnicodeDecodeError as error:
        raise FactoryError("/meta has text that is not UTF-8") from error


def _text_attribute(file: h5py.File, name: str) -> str:
    value = file.attrs.get(name)
    with suppress(UnicodeEncodeError):
        if isinstance(value, str):
            value.encode()
            return value
    raise FactoryError(f"attribute {name} is absent or no text; generate the shard again")


# --- checksums

_CONTENTS, _TEXTS = SEALS
# In the file; what they lead to is in `_texts` by name.
_ADDRESSES = {"DIMENSION_LIST", "REFERENCE_LIST"}


def crc32(values: Array) -> int:
    """CRC-32 of an array's bytes in C order."""
    return int(DEFLATE.crc32(np.ascontiguousarray(values).data))


def write_checksums(file: h5py.File, sums: Mapping[str, Sequence[int]]) -> None:
    """Write /checksums and seal the file, in which everything else stands already.

    sums: layer -> `crc32` of each of its images.
    """
    rows = len(next(iter(sums.values())))
    table = np.empty(rows, dtype=[(name, "<u4") for name in sums])
    for name, values in sums.items():
        table[name] = values
    file.create_dataset(CHECKSUMS, data=table, track_times=False)
    file.attrs[_CONTENTS] = _digest(_contents(file))
    file.attrs[_TEXTS] = _digest(_texts(file, tuple(sums)))


def _check_contents(file: h5py.File) -> None:
    """Compare `checksum`; /checksums must have a row a sample and a column a layer."""
    if not exists(file, CHECKSUMS) or not set(SEALS) <= set(file.attrs):
        raise FactoryError("its checksums are absent; generate the shard again")
    table = dataset_inside(file, CHECKSUMS)
    names = _checksummed_names(file)
    columns = table.dtype.names or ()
    numbers = all(table.dtype[name] == np.dtype("<u4") for name in columns)
    if table.shape != file["meta"].shape or sorted(columns) != sorted(names) or not numbers:
        raise FactoryError(f"/{CHECKSUMS} does not fit the layers; generate the shard again")
    if file.attrs[_CONTENTS] != _digest(_contents(file)):
        raise FactoryError("/meta, /axes or attributes differ from their checksum; damaged")


def check_texts(file: h5py.File) -> None:
    """Read all attributes and axes and compare `text_checksum`, which may raise any exception.

    Raises FactoryError when it differs.
    """
    dict(file.attrs)
    if file.attrs[_TEXTS] != _digest(_texts(file, _checksummed_names(file))):
        raise FactoryError("units or descriptions differ from their checksum; damaged")


def _checksummed_names(file: h5py.File) -> tuple[str, ...]:
    return (*CORE, *optional_layers(file))


def _digest(document: Any) -> str:
    text = json.dumps(document, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _contents(file: h5py.File) -> list[Any]:
    """What `checksum` covers: root attributes, axes, /meta and /checksums."""
    attributes = [
        [name, _value(file.attrs.get(name))] for name in ROOT_ATTRIBUTES if name not in SEALS
    ]
    axes = [[axis.name, crc32(axis.values)] for axis in image_axes(file["noisy"])]
    document: list[Any] = [attributes, axes]
    for table in (file["meta"][()], file[CHECKSUMS][()]):
        columns = [[name, table.dtype[name].str] for name in table.dtype.names or ()]
        document.append([columns, crc32(table)])
    return document


def _texts(file: h5py.File, names: Sequence[str]) -> list[Any]:
    """What `text_checksum` covers: axes of layers, and the attributes of layers, /meta and axes."""
    axes_of_layer: dict[str, list[str]] = {}
    for name in names:
        if name not in CAMERA_LAYERS:  # which have no axes
            dimensions = file[name].dims
            axes_of_layer[name] = [str(dimensions[1].label), str(dimensions[2].label)]
    axis_names = sorted(set(chain.from_iterable(axes_of_layer.values())))

    document: list[Any] = [[[name, axes_of_layer.get(name, [])] for name in names]]
    for name in (*names, "meta", *(f"axes/{axis}" for axis in axis_names)):
        attributes = file[name].attrs
        keys = sorted(attributes.keys() - _ADDRESSES)
        document.append([name, [[key, _value(attributes[key])] for key in keys]])
    return document


def _value(value: Any) -> Any:
    """An attribute as JSON holds it; numpy values with their type."""
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, np.ndarray | np.generic):
        return [value.dtype.str, _value(value.tolist())]
    return value
