"""Is a shard laid out as the schema says, and does everything in it lie in the file itself?

A dataset may come from a stranger.  What is looked at here costs no image: links, types, sizes,
filters and where the chunks are.  A file that passes names no other file, claims no more samples
than it holds, and no chunk of it can grow beyond some thousand times its picture.
"""

from __future__ import annotations

from collections.abc import Iterator
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
# deflate, shuffle, fletcher32, lzf, zstd: what the writer uses.  Any other filter would be a
# library that HDF5 loads from wherever HDF5_PLUGIN_PATH points.
_FILTERS = {1, 2, 3, 32000, 32015}
_ZSTD = 32015


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
    shape = _own(file, "noisy").shape
    dtype = str(file["noisy"].dtype)
    if dtype not in VALUE_RANGES:
        raise FactoryError(f"/noisy is {dtype}; expected {' or '.join(VALUE_RANGES)}")
    for layer in layers(dtype, optional_names(file)):
        _check_stack(_own(file, layer.name), layer, shape)
    _check_table(_own(file, "meta"), shape[0], file.id.get_filesize())


def optional_names(file: h5py.File) -> tuple[str, ...]:
    """Names of the optional layers that a shard has, in the order of the schema."""
    names = [layer.name for layer in OPTIONAL_LAYERS if _exists(file, layer.name)]
    folder = EFFECT_FOLDER.rstrip("/")
    if _exists(file, folder):
        group = hard(file, folder)
        if not isinstance(group, h5py.Group) or len(group) > _MAX_LAYERS:
            raise FactoryError(f"/{folder} is no group of at most {_MAX_LAYERS} layers")
        names += [f"{EFFECT_FOLDER}{name}" for name in sorted(group)]
    return tuple(names)


def image_axes(stack: h5py.Dataset) -> tuple[Axis, Axis]:
    """Row and column axes of an image stack.  Raises FactoryError when one cannot be read."""
    return _axis(stack, 1), _axis(stack, 2)


def _axis(stack: h5py.Dataset, dimension: int) -> Axis:
    size = stack.shape[dimension]
    try:
        scale = stack.dims[dimension][0] if len(stack.dims[dimension]) else None
    except (OSError, RuntimeError, ValueError, KeyError) as error:
        raise FactoryError(f"the axes of {stack.name} are damaged; generate it again") from error
    if scale is None or scale.shape != (size,) or scale.dtype.kind not in "iuf":
        raise FactoryError(f"dimension {dimension} of {stack.name} has no axis of {size} numbers")
    name = str(scale.name).removeprefix("/axes/")
    _check_storage(scale, f"axes/{name}")
    texts = [str(scale.attrs.get(key, "")) for key in ("units", "description")]
    return Axis(name, texts[0], np.asarray(scale[()], dtype=np.float64), texts[1])


def inside(root: Path, path: Path) -> bool:
    """Whether `path`, links followed, is a regular file below `root`."""
    try:
        return path.resolve().is_relative_to(root.resolve()) and path.is_file()
    except (OSError, RuntimeError):
        return False


def _own(file: h5py.File, name: str) -> h5py.Dataset:
    """A dataset that lies in this very file."""
    found = hard(file, name)
    if not isinstance(found, h5py.Dataset):
        raise FactoryError(f"/{name} is no dataset; generate the shard again")
    _check_storage(found, name)
    return found


def hard(file: h5py.File, name: str) -> Any:
    """The object at `name`, refusing links that could lead out of the file on the way."""
    for part in _prefixes(name):
        if not _exists(file, part):
            raise FactoryError(f"dataset /{part} is absent; generate the shard again")
        # Not h5py's own `in` and `get`: they open the file that an external link names.
        if file.id.links.get_info(part.encode()).type != h5py.h5l.TYPE_HARD:
            raise FactoryError(f"/{part} is a link to elsewhere; not followed")
    return file[name]


def _exists(file: h5py.File, name: str) -> bool:
    return bool(file.id.links.exists(name.encode()))


def _prefixes(name: str) -> Iterator[str]:
    parts = name.split("/")
    return ("/".join(parts[: count + 1]) for count in range(len(parts)))


def _check_storage(dataset: h5py.Dataset, name: str) -> None:
    plist = dataset.id.get_create_plist()
    if plist.get_layout() == h5py.h5d.VIRTUAL or plist.get_external_count():
        raise FactoryError(f"/{name} keeps its data in another file; not followed")


def _check_stack(stack: h5py.Dataset, layer: Layer, shape: tuple[int, ...]) -> None:
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
    _check_filters(stack, name)
    full = picture[0] * picture[1] * stack.dtype.itemsize
    chunks = 0

    def look(chunk: Any) -> None:
        nonlocal chunks
        chunks += 1
        # zstd, deflate and lzf all grow incompressible data by far less.
        if chunk.size > full + full // 16 + 4096:
            raise FactoryError(f"{name} has a chunk of {chunk.size} bytes for {full} of pixels")

    stack.id.chunk_iter(look)
    if chunks != samples:
        raise FactoryError(f"{name} holds {chunks} of {samples} samples; generate it again")


def _check_filters(stack: h5py.Dataset, name: str) -> None:
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
    if table.chunks is not None:
        raise FactoryError("/meta is stored in chunks; the schema keeps it in one piece")
