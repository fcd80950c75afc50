"""Is a shard laid out as the schema says, and does everything in it lie in the file itself?

A dataset may come from a stranger or a dying disk.  What is checked here reads no image: links,
types, sizes, filters, attributes, and where in the file the data are.  A file that passes names no
other file, claims no more samples than it holds, has one chunk for each picture at a place of its
own, and no chunk of it can grow beyond some thousand times its picture.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from simnfnd.factory.dataset.format.sample import Axis
from simnfnd.factory.dataset.format.schema import (
    EFFECT_FOLDER,
    OPTIONAL_LAYERS,
    REQUIRED_COLUMNS,
    SCHEMA,
    SPLITS,
    VALUE_RANGES,
    Layer,
    layers,
    stores_grey,
)
from simnfnd.factory.errors import FactoryError

# A picture of 4096 x 4096; the largest imaging sonars have 2048 beams.
MAX_PIXELS = 1 << 24
_MAX_ROW_BYTES = 1 << 16
_MAX_LAYERS = 64
_MAX_AXES = 8
# deflate, shuffle, fletcher32, lzf, zstd: what the writer uses.  Any other filter would be a
# library that HDF5 loads from wherever HDF5_PLUGIN_PATH points.
_FILTERS = {1, 2, 3, 32000, 32015}
_ZSTD = 32015
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
    shape = _dataset_inside(file, "noisy").shape
    dtype = str(file["noisy"].dtype)
    if dtype not in VALUE_RANGES:
        raise FactoryError(f"/noisy is {dtype}; expected {' or '.join(VALUE_RANGES)}")
    size = file.id.get_filesize()
    places: list[tuple[int, int, str]] = []
    for layer in layers(dtype, optional_layers(file)):
        places += _check_stack(_dataset_inside(file, layer.name), layer, shape, size)
    table = _dataset_inside(file, "meta")
    _check_table(table, shape[0], size)
    places += _contiguous_place(table, "meta", size)
    for name in _axis_names(file):
        places += _contiguous_place(_dataset_inside(file, f"axes/{name}"), f"axes/{name}", size)
    _check_apart(places)
    _check_attributes(file)
    _check_text(table)


def optional_layers(file: h5py.File) -> tuple[str, ...]:
    """Names of the optional layers that a shard has, in the order of the schema."""
    names = [layer.name for layer in OPTIONAL_LAYERS if _exists(file, layer.name)]
    folder = EFFECT_FOLDER.rstrip("/")
    if _exists(file, folder):
        group = object_inside(file, folder)
        if not isinstance(group, h5py.Group) or len(group) > _MAX_LAYERS:
            raise FactoryError(f"/{folder} is no group of at most {_MAX_LAYERS} layers")
        names += [f"{EFFECT_FOLDER}{name}" for name in sorted(group)]
    return tuple(names)


def image_axes(stack: h5py.Dataset) -> tuple[Axis, Axis]:
    """Row and column axes of an image stack.  Raises FactoryError when one cannot be read."""
    _check_scale_references(stack)
    return _axis(stack, 1), _axis(stack, 2)


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


def object_inside(file: h5py.File, name: str) -> Any:
    """The object at `name`; links that could lead out of the file are refused on the way."""
    for part in _prefixes(name):
        if not _exists(file, part):
            raise FactoryError(f"dataset /{part} is absent; generate the shard again")
        # Not h5py's own `in` and `get`: they open the file that an external link names.
        if file.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
            raise FactoryError(f"/{part} is a link to elsewhere; not followed")
    return file[name]


def _axis(stack: h5py.Dataset, dimension: int) -> Axis:
    size = stack.shape[dimension]
    try:
        scale = stack.dims[dimension][0] if len(stack.dims[dimension]) else None
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise FactoryError(f"the axes of {stack.name} are damaged; generate it again") from error
    if scale is None or scale.shape != (size,) or scale.dtype.kind not in "iuf":
        raise FactoryError(f"dimension {dimension} of {stack.name} has no axis of {size} numbers")
    name = str(scale.name).removeprefix("/axes/")
    _contiguous_place(scale, f"axes/{name}", scale.file.id.get_filesize())
    texts = [str(scale.attrs.get(key, "")) for key in ("units", "description")]
    return Axis(name, texts[0], np.asarray(scale[()], dtype=np.float64), texts[1])


def _check_scale_references(stack: h5py.Dataset) -> None:
    """HDF5 follows whatever stands in DIMENSION_LIST, and dies of numbers there."""
    name = b"DIMENSION_LIST"
    if not h5py.h5a.exists(stack.id, name):
        raise FactoryError(f"{stack.name} has no axes; generate the shard again")
    attribute = h5py.h5a.open(stack.id, name)
    kind = attribute.get_type()
    listed = isinstance(kind, h5py.h5t.TypeVlenID) and attribute.shape == (stack.ndim,)
    if not listed or not kind.get_super().equal(h5py.h5t.STD_REF_OBJ):
        raise FactoryError(f"the axes of {stack.name} are damaged; generate it again")


def _axis_names(file: h5py.File) -> list[str]:
    if not _exists(file, "axes"):
        return []
    group = object_inside(file, "axes")
    if not isinstance(group, h5py.Group) or len(group) > _MAX_AXES:
        raise FactoryError(f"/axes is no group of at most {_MAX_AXES} axes")
    return sorted(group)


def _dataset_inside(file: h5py.File, name: str) -> h5py.Dataset:
    """A dataset that lies in this very file."""
    found = object_inside(file, name)
    if not isinstance(found, h5py.Dataset):
        raise FactoryError(f"/{name} is no dataset; generate the shard again")
    plist = found.id.get_create_plist()
    if plist.get_layout() == h5py.h5d.VIRTUAL or plist.get_external_count():
        raise FactoryError(f"/{name} keeps its data in another file; not followed")
    return found


def _exists(file: h5py.File, name: str) -> bool:
    return bool(file.id.links.exists(name.encode()))


def _prefixes(name: str) -> Iterator[str]:
    parts = name.split("/")
    return ("/".join(parts[: count + 1]) for count in range(len(parts)))


def _check_stack(
    stack: h5py.Dataset, layer: Layer, shape: tuple[int, ...], file_bytes: int
) -> list[tuple[int, int, str]]:
    """The (first byte, end, name) of every chunk of a sound stack."""
    name = f"/{layer.name}"
    if stack.ndim != 3 or stack.shape != shape:
        raise FactoryError(f"{name} is {stack.shape}, /noisy {shape}; generate it again")
    samples, *picture = shape
    if 0 in picture or picture[0] * picture[1] > MAX_PIXELS:
        raise FactoryError(f"{name} claims pictures of {picture}; at most {MAX_PIXELS} pixels go")
    # Of the same layer in other shards, too: grey values are all of one dtype.
    if str(stack.dtype) != layer.dtype:
        wanted = " or ".join(VALUE_RANGES) if stores_grey(layer) else layer.dtype
        raise FactoryError(f"{name} is {stack.dtype}; expected {wanted}")
    if stack.chunks != (1, *picture):
        raise FactoryError(f"{name} has chunks {stack.chunks}; expected one for each picture")
    filtered = _check_filters(stack, name)
    full = picture[0] * picture[1] * stack.dtype.itemsize
    # zstd, deflate and lzf all grow incompressible data by far less.
    most, least = (full + full // 16 + 4096, 1) if filtered else (full, full)
    places: list[tuple[int, int, str]] = []

    def check_chunk(chunk: Any) -> None:
        number = len(places)
        if not least <= chunk.size <= most:
            raise FactoryError(f"{name} has a chunk of {chunk.size} bytes for {full} of pixels")
        # Their table has no checksum, and HDF5 would show another picture, or no picture's bytes.
        if chunk.chunk_offset != (number, 0, 0) or number >= samples:
            raise FactoryError(f"{name}: its table of chunks is damaged; generate it again")
        if chunk.filter_mask:
            raise FactoryError(f"{name} sample {number} skips its filters; generate it again")
        if chunk.byte_offset is None or chunk.byte_offset + chunk.size > file_bytes:
            raise FactoryError(f"{name} sample {number} lies beyond the file; generate it again")
        places.append((chunk.byte_offset, chunk.byte_offset + chunk.size, name))

    stack.id.chunk_iter(check_chunk)
    if len(places) != samples:
        raise FactoryError(f"{name} holds {len(places)} of {samples} samples; generate it again")
    return places


def _contiguous_place(
    dataset: h5py.Dataset, name: str, file_bytes: int
) -> list[tuple[int, int, str]]:
    """The (first byte, end, name) of a dataset that is stored in one piece, as it must be."""
    if dataset.id.get_create_plist().get_layout() != h5py.h5d.CONTIGUOUS:
        raise FactoryError(f"/{name} is stored in chunks; the schema keeps it in one piece")
    size = int(np.prod(dataset.shape, dtype=np.int64)) * dataset.id.get_type().get_size()
    if not size:
        return []
    start = dataset.id.get_offset()
    if start is None or start + size > file_bytes or dataset.id.get_storage_size() != size:
        raise FactoryError(f"/{name} is not where the file says; generate it again")
    return [(start, start + size, f"/{name}")]


def _check_apart(places: list[tuple[int, int, str]]) -> None:
    """No two pieces of data may share bytes: one of them would be read from a wrong place."""
    places.sort()
    for (_, end, one), (start, _, two) in pairwise(places):
        if start < end:
            raise FactoryError(f"{one} and {two} share bytes of the file; generate it again")


def _check_filters(stack: h5py.Dataset, name: str) -> bool:
    """Whether the chunks of a stack are filtered; raises FactoryError for any unknown filter."""
    plist = stack.id.get_create_plist()
    codes = [plist.get_filter(index)[0] for index in range(plist.get_nfilters())]
    if not _FILTERS.issuperset(codes) or len(set(codes)) != len(codes):
        raise FactoryError(f"{name} uses filters {codes}, which are not of {SCHEMA}")
    if _ZSTD in codes and not h5py.h5z.filter_avail(_ZSTD):
        try:
            import hdf5plugin  # noqa: F401  (registers its filters; 186 MB, so only when needed)
        except ImportError as error:
            raise FactoryError(
                "compressed with zstd, which needs the hdf5plugin package: "
                "pip install 'simnfnd[zstd]'"
            ) from error
    if not all(h5py.h5z.filter_avail(code) for code in codes):
        raise FactoryError(f"{name} uses filters {codes}, which this h5py lacks; renew h5py")
    return bool(codes)


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
    if table.dtype.itemsize > _MAX_ROW_BYTES or table.dtype.itemsize * samples > file_bytes:
        raise FactoryError("/meta claims more bytes than the file has")


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


def _check_text(table: h5py.Dataset) -> None:
    """Names are decoded wherever they are shown."""
    rows = table[()]
    for name in table.dtype.names:
        if table.dtype[name].kind == "S":
            try:
                for value in rows[name].tolist():
                    value.decode()
            except UnicodeDecodeError as error:
                raise FactoryError(f"/meta: column {name} has text that is not UTF-8") from error
