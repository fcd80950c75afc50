"""Checksums of a shard: of every picture, of the tables, and of all texts.

HDF5 has none for what it keeps in one piece (/meta, /axes, plain pictures), for texts, and for the
tables that say where a chunk lies.  So a shard has

- `/checksums`, one row a sample and one column a layer: CRC-32 of the picture's bytes;
- the root attribute `checksum`, of the other root attributes, /meta, the axes and `/checksums`;
- the root attribute `text_checksum`, of what the layers, columns and axes say of themselves.

The latter two are BLAKE2b (digest of 16 bytes, hexadecimal) of a JSON text that `_contents` and
`_texts` write.
"""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from importlib import import_module
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ..errors import FactoryError
from .layout import (
    ECHO_PLACE,
    axis_names,
    dataset_inside,
    echo_names,
    exists,
    image_axes,
    optional_layers,
)
from .schema import CHECKSUMS, CORE, ROOT_ATTRIBUTES, SEALS

DEFLATE: Any = zlib
with suppress(ImportError):
    DEFLATE = import_module("isal.isal_zlib")
"""isal's zlib, in a third to two thirds of the time; readers may have numpy and h5py alone."""

_CONTENTS, _TEXTS = SEALS
# Addresses in the file; what they lead to is in `_texts` by name.
_REFERENCES = ("DIMENSION_LIST", "REFERENCE_LIST")


def crc32(values: npt.NDArray[Any]) -> int:
    """CRC-32 of an array's bytes in C order."""
    return int(DEFLATE.crc32(np.ascontiguousarray(values).data))


def write_checksums(file: h5py.File, sums: Mapping[str, Sequence[int]]) -> None:
    """Write /checksums and seal the file, in which everything else stands already.

    sums: layer -> `crc32` of each of its pictures.
    """
    rows = len(next(iter(sums.values())))
    table = np.empty(rows, dtype=[(name, "<u4") for name in sums])
    for name, values in sums.items():
        table[name] = values
    file.create_dataset(CHECKSUMS, data=table, track_times=False)
    file.attrs[_CONTENTS] = _digest(_contents(file))
    file.attrs[_TEXTS] = _digest(_texts(file, sums))


def check_contents(file: h5py.File) -> None:
    """Compare `checksum` in a file of sound layout.  Raises FactoryError when it differs.

    A row a sample and a column a layer must be in /checksums.
    """
    parts = [name in file.attrs for name in SEALS] + [exists(file, CHECKSUMS)]
    if not all(parts):
        some = "some of its" if any(parts) else "its"
        raise FactoryError(
            f"{some} checksums are absent; generate the shard again (versions before 0.3 wrote "
            "none)"
        )
    table, names = dataset_inside(file, CHECKSUMS), _summed(file)
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
    if file.attrs[_TEXTS] != _digest(_texts(file, _summed(file))):
        raise FactoryError("units or descriptions differ from their checksum; damaged")


def picture_sums(file: h5py.File) -> npt.NDArray[np.void]:
    """(samples,) `crc32` of each picture, a column a layer."""
    sums: npt.NDArray[np.void] = file[CHECKSUMS][()]
    return sums


def _summed(file: h5py.File) -> tuple[str, ...]:
    return (*CORE, *optional_layers(file), *echo_names(file))


def _digest(document: Any) -> str:
    text = json.dumps(document, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _contents(file: h5py.File) -> list[Any]:
    tables = (file["meta"][()], file[CHECKSUMS][()])
    return [
        [[name, _value(file.attrs.get(name))] for name in ROOT_ATTRIBUTES if name not in SEALS],
        [[axis.name, crc32(axis.values)] for axis in image_axes(file["noisy"])],
        *([["echoes", crc32(file[ECHO_PLACE][()])]] if echo_names(file) else []),
        *([[[n, t.dtype[n].str] for n in t.dtype.names or ()], crc32(t)] for t in tables),
    ]


def _texts(file: h5py.File, layers: Iterable[str]) -> list[Any]:
    named = [(name, axis_names(file[name])) for name in layers]
    axes = {axis for _, both in named for axis in both}
    return [
        [[name, list(both)] for name, both in named],
        *(
            [name, [[key, _value(value)] for key, value in sorted(_attributes(file[name]))]]
            for name in (*dict(named), "meta", *(f"axes/{axis}" for axis in sorted(axes)))
        ),
    ]


def _attributes(item: h5py.Dataset) -> list[tuple[str, Any]]:
    return [(name, item.attrs[name]) for name in item.attrs if name not in _REFERENCES]


def _value(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, np.ndarray | np.generic):
        listed = value.tolist()
        return [value.dtype.str, listed.hex() if isinstance(listed, bytes) else listed]
    return value
