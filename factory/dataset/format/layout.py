"""Is a shard laid out as the schema says, and does everything in it lie in the file itself?

A dataset may come from a stranger or a dying disk.  What is checked here reads no image: links,
types, sizes, filters, attributes, and where in the file the data are.  A file that passes names no
other file, claims no more samples than it holds, has one chunk for each picture at a place of its
own, and no chunk of it can grow beyond some thousand times its picture.
"""

from __future__ import annotations

import json
from itertools import pairwise
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from .axes import Place, contiguous_place
from .checksums import check_contents, has_checksums
from .echoes import check_echoes, echo_names
from .filters import chain_of
from .layers import (
    CHANNELS,
    EFFECT_FOLDER,
    MAX_PIXELS,
    OPTIONAL_LAYERS,
    Layer,
    layers,
    stores_grey,
)
from .links import dataset_inside, exists, object_inside
from .schema import (
    CHECKSUMS,
    REQUIRED_COLUMNS,
    SCHEMA,
    SPLITS,
    VALUE_RANGES,
)

_MAX_ROW_BYTES = 1 << 16
_MAX_LAYERS = 64
_MAX_AXES = 8
# Of all layers of a shard together: what is noted of each takes some hundred bytes.
_MAX_CHUNKS = 1 << 20
_MAX_TABLE_BYTES = 1 << 27
_TEXT_ATTRIBUTES = ("generator", "config", "config_hash", "split")


def check_shard(file: h5py.File) -> None:
    """Raise FactoryError (without the file's name) with what keeps an open shard from being read.

    Other exceptions can escape from HDF5 itself when the file is damaged.
    """
    schema = file.attrs.get("schema")
    if schema is None:
        raise FactoryError("no schema attribute; not a SimNFND shard")
    if not isinstance(schema, str) or schema != SCHEMA:
        raise FactoryError(
            f"schema {str(schema)[:40]!r}, but this program reads {SCHEMA!r}; "
            "use a matching release"
        )
    noisy = dataset_inside(file, "noisy")
    shape, dtype = noisy.shape, str(noisy.dtype)
    if len(shape) != 3:
        raise FactoryError(f"/noisy is {shape}; expected samples, rows and columns")
    if dtype not in VALUE_RANGES:
        raise FactoryError(f"/noisy is {dtype}; expected {' or '.join(VALUE_RANGES)}")
    size = file.id.get_filesize()
    places: list[Place] = []
    known = layers(dtype, optional_layers(file))
    if shape[0] * len(known) > _MAX_CHUNKS:
        raise FactoryError(f"claims {shape[0]} samples; at most {_MAX_CHUNKS} pictures go")
    for layer in known:
        places += _check_stack(dataset_inside(file, layer.name), layer, shape, size)
    table = dataset_inside(file, "meta")
    _check_table(table, shape[0], size)
    places += contiguous_place(table, "meta", size)
    places += check_echoes(file, shape[0], size)
    if has_checksums(file):
        names = [*(layer.name for layer in known), *echo_names(file)]
        places += _checked_sums(file, names, shape[0], size)
    for name in _axis_names(file):
        places += contiguous_place(dataset_inside(file, f"axes/{name}"), f"axes/{name}", size)
    _check_apart(places)
    _check_attributes(file)
    rows = table[()]
    _check_text(rows)
    if has_checksums(file):
        check_contents(file, rows)


def optional_layers(file: h5py.File) -> tuple[str, ...]:
    """Names of the optional layers that a shard has, in the order of the schema."""
    names = [layer.name for layer in OPTIONAL_LAYERS if exists(file, layer.name)]
    folder = EFFECT_FOLDER.rstrip("/")
    if exists(file, folder):
        group = object_inside(file, folder)
        if not isinstance(group, h5py.Group) or len(group) > _MAX_LAYERS:
            raise FactoryError(f"/{folder} is no group of at most {_MAX_LAYERS} layers")
        names += [f"{EFFECT_FOLDER}{name}" for name in sorted(group)]
    return tuple(names)


def config_of(file: h5py.File) -> dict[str, Any]:
    """The settings that a shard states in its `config` attribute.

    Raises FactoryError (without the file's name) when they are absent or damaged.
    """
    try:
        config = json.loads(_text_attribute(file, "config"))
    except (ValueError, RecursionError) as error:
        raise FactoryError("attribute config is no JSON; generate the shard again") from error
    if not isinstance(config, dict):
        raise FactoryError("attribute config is no JSON object; generate the shard again")
    return config


def inside(root: Path, path: Path) -> bool:
    """Whether `path`, links followed, is a regular file below `root`."""
    try:
        return path.resolve().is_relative_to(root.resolve()) and path.is_file()
    except (OSError, RuntimeError):
        return False


def _axis_names(file: h5py.File) -> list[str]:
    if not exists(file, "axes"):
        return []
    group = object_inside(file, "axes")
    if not isinstance(group, h5py.Group) or len(group) > _MAX_AXES:
        raise FactoryError(f"/axes is no group of at most {_MAX_AXES} axes")
    return sorted(group)


def _check_stack(
    stack: h5py.Dataset, layer: Layer, shape: tuple[int, ...], file_bytes: int
) -> list[Place]:
    """The (first byte, end, name) of every chunk of a sound stack."""
    name = f"/{layer.name}"
    if layer.of_camera:
        fits = stack.ndim == 1 + len(layer.of_camera) and stack.shape[3:] in ((), (CHANNELS,))
        if not fits or stack.shape[0] != shape[0]:
            raise FactoryError(
                f"{name} is {stack.shape}; expected {shape[0]} samples of "
                f"{', '.join(layer.of_camera)}; generate it again"
            )
    elif stack.ndim != 3 or stack.shape != shape:
        raise FactoryError(f"{name} is {stack.shape}, /noisy {shape}; generate it again")
    samples, *picture = stack.shape
    if 0 in picture or picture[0] * picture[1] > MAX_PIXELS:
        raise FactoryError(f"{name} claims pictures of {picture}; at most {MAX_PIXELS} pixels go")
    # Of the same layer in other shards, too: grey values are all of one dtype.
    if str(stack.dtype) != layer.dtype:
        wanted = " or ".join(VALUE_RANGES) if stores_grey(layer) else layer.dtype
        raise FactoryError(f"{name} is {stack.dtype}; expected {wanted}")
    if stack.chunks != (1, *picture):
        raise FactoryError(f"{name} has chunks {stack.chunks}; expected one for each picture")
    chain = chain_of(stack)
    full = prod(picture) * stack.dtype.itemsize
    origin = (0,) * len(picture)
    places: list[Place] = []

    def check_chunk(chunk: Any) -> None:
        number = len(places)
        # Their table has no checksum, and HDF5 would show another picture, or no picture's bytes.
        if chunk.chunk_offset != (number, *origin) or number >= samples:
            raise FactoryError(f"{name}: its table of chunks is damaged; generate it again")
        if not chain.may_be(chunk.filter_mask, chunk.size, full):
            if chunk.filter_mask:
                raise FactoryError(f"{name} sample {number} skips its filters; generate it again")
            raise FactoryError(f"{name} has a chunk of {chunk.size} bytes for {full} of pixels")
        if chunk.byte_offset is None or chunk.byte_offset + chunk.size > file_bytes:
            raise FactoryError(f"{name} sample {number} lies beyond the file; generate it again")
        places.append((chunk.byte_offset, chunk.byte_offset + chunk.size, name))

    stack.id.chunk_iter(check_chunk)
    if len(places) != samples:
        raise FactoryError(f"{name} holds {len(places)} of {samples} samples; generate it again")
    return places


def _check_apart(places: list[Place]) -> None:
    """No two pieces of data may share bytes: one of them would be read from a wrong place."""
    places.sort()
    for (_, end, one), (start, _, two) in pairwise(places):
        if start < end:
            raise FactoryError(f"{one} and {two} share bytes of the file; generate it again")


def _checked_sums(file: h5py.File, names: list[str], samples: int, file_bytes: int) -> list[Place]:
    """Where /checksums lies, which must have a row a sample and a column a layer."""
    table = dataset_inside(file, CHECKSUMS)
    columns = table.dtype.names or ()
    numbers = all(table.dtype[name] == np.dtype("<u4") for name in columns)
    if table.shape != (samples,) or sorted(columns) != sorted(names) or not numbers:
        raise FactoryError(f"/{CHECKSUMS} does not fit the layers; generate the shard again")
    return contiguous_place(table, CHECKSUMS, file_bytes)


def _check_table(table: h5py.Dataset, samples: int, file_bytes: int) -> None:
    names = table.dtype.names or ()
    kinds = {table.dtype[name].kind for name in names}
    if table.shape != (samples,) or not set(REQUIRED_COLUMNS).issubset(names):
        raise FactoryError(
            f"/meta must have {samples} rows with the columns {', '.join(REQUIRED_COLUMNS)}"
        )
    text = {table.dtype[name].kind for name in REQUIRED_COLUMNS[:3]}
    if not kinds <= set("iufS") or text != {"S"} or table.dtype["variant"].kind not in "iu":
        raise FactoryError("/meta has columns of types that the schema does not know")
    size = table.dtype.itemsize * samples
    if table.dtype.itemsize > _MAX_ROW_BYTES or size > min(file_bytes, _MAX_TABLE_BYTES):
        raise FactoryError("/meta claims more bytes than the file has, or than a table may have")


def _check_attributes(file: h5py.File) -> None:
    for name in _TEXT_ATTRIBUTES:
        _text_attribute(file, name)
    config_of(file)
    split = _text_attribute(file, "split")
    if split not in SPLITS:
        raise FactoryError(
            f"attribute split is {split[:40]!r}; expected {' or '.join(SPLITS)}; generate the "
            "shard again"
        )


def _text_attribute(file: h5py.File, name: str) -> str:
    value = file.attrs.get(name)
    if value is None:
        raise FactoryError(f"attribute {name} is absent; generate the shard again")
    if not isinstance(value, str):
        raise FactoryError(f"attribute {name} is no text; generate the shard again")
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise FactoryError(f"attribute {name} is not UTF-8; generate the shard again") from error
    return value


def _check_text(rows: npt.NDArray[Any]) -> None:
    """Names are decoded wherever they are shown."""
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "S":
            try:
                for value in rows[name].tolist():
                    value.decode()
            except UnicodeDecodeError as error:
                raise FactoryError(f"/meta: column {name} has text that is not UTF-8") from error
