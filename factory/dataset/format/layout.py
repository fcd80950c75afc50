"""Is a shard laid out as the schema says, and does everything in it lie in the file itself?

A dataset may come from a stranger or a dying disk.  What is checked here reads no image: links,
types, sizes, filters and attributes.  A file that passes names no other file, claims no more
samples than it holds, and has one chunk for each picture; its checksum says whether that is the
right one.
"""

from __future__ import annotations

from contextlib import suppress
from math import prod
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ...small_files import parse_json
from .axes import dataset_inside, echo_names, exists, object_inside
from .checksums import check_contents, require_checksums
from .schema import (
    CHANNELS,
    CHECKSUMS,
    EFFECT_FOLDER,
    MAX_PIXELS,
    OPTIONAL_LAYERS,
    REQUIRED_COLUMNS,
    SCHEMA,
    SPLITS,
    VALUE_RANGES,
    Layer,
    layers,
    stores_grey,
)

_MAX_ROW_BYTES = 1 << 16
_MAX_LAYERS = 64
# Of all layers of a shard together: what is noted of each takes some hundred bytes.
_MAX_CHUNKS = 1 << 20
_MAX_TABLE_BYTES = 1 << 27

_DEFLATE, _LZF, _ZSTD, _FLETCHER32 = 1, 32000, 32015, 3
_CODECS = {_DEFLATE: "gzip", _LZF: "lzf", _ZSTD: "zstd"}


def _filters(stack: h5py.Dataset) -> tuple[str, int]:
    """Compression of an image stack (or none), and bytes of its Fletcher-32 checksum, 4 or 0.

    Raises FactoryError for any filter that the schema has not: it would be a library that HDF5
    loads from wherever HDF5_PLUGIN_PATH points, or let a chunk grow without bound.
    """
    plist = stack.id.get_create_plist()
    codes = [plist.get_filter(index)[0] for index in range(plist.get_nfilters())]
    ending = 4 if codes[-1:] == [_FLETCHER32] else 0
    codecs = codes[: len(codes) - bool(ending)]
    if len(codecs) > 1 or not set(codecs) <= set(_CODECS):
        raise FactoryError(f"{stack.name} uses filters {codes}, which are not of {SCHEMA}")
    if _ZSTD in codes and not h5py.h5z.filter_avail(_ZSTD):
        try:
            import hdf5plugin  # noqa: F401  (registers its filters; 186 MB, so only when needed)
        except ImportError as error:
            raise FactoryError(
                "compressed with zstd, which needs the hdf5plugin package: "
                "pip install 'simnfnd[zstd]'"
            ) from error
    return _CODECS[codecs[0]] if codecs else "none", ending


def check_shard(file: h5py.File) -> None:
    """Raise FactoryError (without the file's name) with what keeps an open shard from being read.

    Other exceptions can escape from HDF5 itself when the file is damaged.
    """
    schema = file.attrs.get("schema")
    if not isinstance(schema, str) or schema != SCHEMA:
        raise FactoryError(
            f"schema {str(schema)[:40]!r}, but this program reads {SCHEMA!r}; "
            "use a matching release"
        )
    noisy = dataset_inside(file, "noisy", chunks=True)
    shape, dtype = noisy.shape, str(noisy.dtype)
    if len(shape) != 3:
        raise FactoryError(f"/noisy is {shape}; expected samples, rows and columns")
    if dtype not in VALUE_RANGES:
        raise FactoryError(f"/noisy is {dtype}; expected {' or '.join(VALUE_RANGES)}")
    known = layers(dtype, optional_layers(file))
    if shape[0] * len(known) > _MAX_CHUNKS:
        raise FactoryError(f"claims {shape[0]} samples; at most {_MAX_CHUNKS} pictures go")
    for layer in known:
        _check_stack(dataset_inside(file, layer.name, chunks=True), layer, shape)
    _check_table(dataset_inside(file, "meta"), shape[0])
    require_checksums(file)
    _check_sums(file, [*(layer.name for layer in known), *echo_names(file)], shape[0])
    _check_attributes(file)
    rows = file["meta"][()]
    _check_text(rows)
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
    text, config = _text_attribute(file, "config"), None
    with suppress(ValueError):
        config = parse_json(text)
    if not isinstance(config, dict):
        raise FactoryError("attribute config is no JSON object; generate the shard again")
    return config


def inside(root: Path, path: Path) -> bool:
    """Whether `path`, links followed, is a regular file below `root`."""
    try:
        return path.resolve().is_relative_to(root.resolve()) and path.is_file()
    except (OSError, RuntimeError):
        return False


def _check_stack(stack: h5py.Dataset, layer: Layer, shape: tuple[int, ...]) -> None:
    """A stack has the shape, type, chunks and filters of its layer, and a chunk a sample."""
    name, (samples, *picture) = f"/{layer.name}", stack.shape or (0,)
    fits = stack.shape == shape
    if layer.of_camera:
        fits = samples == shape[0] and stack.shape[3:] in ((), (CHANNELS,))
        fits = fits and stack.ndim == 1 + len(layer.of_camera)
    if not fits:
        expected = (
            f"{shape[0]} samples of {', '.join(layer.of_camera)}" if layer.of_camera else shape
        )
        raise FactoryError(f"{name} is {stack.shape}; expected {expected}; generate it again")
    if 0 in picture or picture[0] * picture[1] > MAX_PIXELS:
        raise FactoryError(f"{name} claims pictures of {picture}; at most {MAX_PIXELS} pixels go")
    # Of the same layer in other shards, too: grey values are all of one dtype.
    if str(stack.dtype) != layer.dtype:
        wanted = " or ".join(VALUE_RANGES) if stores_grey(layer) else layer.dtype
        raise FactoryError(f"{name} is {stack.dtype}; expected {wanted}")
    if stack.chunks != (1, *picture):
        raise FactoryError(f"{name} has chunks {stack.chunks}; expected one for each picture")
    # Their table has no checksum, and HDF5 aborts over sizes that cannot be.
    (codec, ending), file_bytes = _filters(stack), stack.file.id.get_filesize()
    full = prod(picture) * stack.dtype.itemsize + ending
    # What cannot be made smaller grows by far less than that.
    most = full if codec == "none" else full + full // 16 + 4096
    origin, found = (0,) * len(picture), 0

    def check_chunk(chunk: Any) -> None:
        nonlocal found
        if chunk.chunk_offset != (found, *origin) or found >= samples:
            raise FactoryError(f"{name}: its table of chunks is damaged; generate it again")
        # LZF alone leaves a chunk as it is where it cannot make it smaller.
        if chunk.filter_mask and (codec, chunk.filter_mask, chunk.size) != ("lzf", 1, full):
            raise FactoryError(f"{name} sample {found} skips its filters; generate it again")
        if not (full if codec == "none" else ending + 1) <= chunk.size <= most:
            raise FactoryError(
                f"{name} sample {found} has a chunk of {chunk.size} bytes; generate it again"
            )
        if chunk.byte_offset is None or chunk.byte_offset + chunk.size > file_bytes:
            raise FactoryError(f"{name} sample {found} lies beyond the file; generate it again")
        found += 1

    stack.id.chunk_iter(check_chunk)
    if found != samples:
        raise FactoryError(f"{name} holds {found} of {samples} samples; generate it again")


def _check_sums(file: h5py.File, names: list[str], samples: int) -> None:
    """A row a sample and a column a layer."""
    table = dataset_inside(file, CHECKSUMS)
    columns = table.dtype.names or ()
    numbers = all(table.dtype[name] == np.dtype("<u4") for name in columns)
    if table.shape != (samples,) or sorted(columns) != sorted(names) or not numbers:
        raise FactoryError(f"/{CHECKSUMS} does not fit the layers; generate the shard again")


def _check_table(table: h5py.Dataset, samples: int) -> None:
    names = table.dtype.names or ()
    kinds = {table.dtype[name].kind for name in names}
    if table.shape != (samples,) or not set(REQUIRED_COLUMNS).issubset(names):
        raise FactoryError(
            f"/meta must have {samples} rows with the columns {', '.join(REQUIRED_COLUMNS)}"
        )
    text = {table.dtype[name].kind for name in REQUIRED_COLUMNS[:3]}
    if not kinds <= set("iufS") or text != {"S"} or table.dtype["variant"].kind not in "iu":
        raise FactoryError("/meta has columns of types that the schema does not know")
    bytes_ = table.dtype.itemsize * samples
    if table.dtype.itemsize > _MAX_ROW_BYTES or bytes_ > _MAX_TABLE_BYTES:
        raise FactoryError("/meta claims more bytes than a table may have")


def _check_attributes(file: h5py.File) -> None:
    for name in ("generator", "config_hash"):
        _text_attribute(file, name)
    config_of(file)
    if (split := _text_attribute(file, "split")) not in SPLITS:
        raise FactoryError(
            f"attribute split is {split[:40]!r}; expected {' or '.join(SPLITS)}; generate the "
            "shard again"
        )


def _text_attribute(file: h5py.File, name: str) -> str:
    value = file.attrs.get(name)
    with suppress(UnicodeEncodeError):
        if isinstance(value, str):
            value.encode()
            return value
    raise FactoryError(f"attribute {name} is absent or no text; generate the shard again")


def _check_text(rows: npt.NDArray[Any]) -> None:
    """Names are decoded wherever they are shown."""
    for name in rows.dtype.names or ():
        if rows.dtype[name].kind == "S":
            try:
                b" ".join(rows[name].tolist()).decode()
            except UnicodeDecodeError as error:
                raise FactoryError(f"/meta: column {name} has text that is not UTF-8") from error
