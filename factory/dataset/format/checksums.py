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
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from .axes import ECHO_PLACE, axis_names, echo_names, exists, image_axes
from .schema import CHECKSUMS, ROOT_ATTRIBUTES, SEALS

_CONTENTS, _TEXTS = SEALS
# Addresses in the file; what they lead to is in `_texts` by name.
_REFERENCES = ("DIMENSION_LIST", "REFERENCE_LIST")


def _deflate() -> Any:
    try:
        from isal import isal_zlib
    except ImportError:
        import zlib

        return zlib
    return isal_zlib


DEFLATE = _deflate()
"""isal's zlib, in a third to two thirds of the time; readers may have numpy and h5py alone."""


def crc32(values: npt.NDArray[Any]) -> int:
    """CRC-32 of an array's bytes in C order."""
    sums: int = DEFLATE.crc32(np.ascontiguousarray(values).data)
    return sums


def write_checksums(file: h5py.File, sums: Mapping[str, Sequence[int]]) -> None:
    """Write /checksums and seal the file, in which everything else stands already.

    sums: layer -> `crc32` of each of its pictures.
    """
    rows = len(next(iter(sums.values())))
    table = np.empty(rows, dtype=[(name, "<u4") for name in sums])
    for name, values in sums.items():
        table[name] = values
    file.create_dataset(CHECKSUMS, data=table, track_times=False)
    file.attrs[_CONTENTS] = _digest(_contents(file, file["meta"][()]))
    file.attrs[_TEXTS] = _digest(_texts(file, sums))


def require_checksums(file: h5py.File) -> None:
    """Raise FactoryError for a shard that has lost some, or never had any."""
    parts = [name in file.attrs for name in SEALS] + [exists(file, CHECKSUMS)]
    if not all(parts):
        some = "some of its" if any(parts) else "its"
        raise FactoryError(
            f"{some} checksums are absent; generate the shard again (versions before 0.3 wrote "
            "none)"
        )


def check_contents(file: h5py.File, rows: npt.NDArray[Any]) -> None:
    """Compare `checksum`.  Raises FactoryError when it differs.

    rows: those of /meta.
    """
    if file.attrs[_CONTENTS] != _digest(_contents(file, rows)):
        raise FactoryError("/meta, /axes or attributes differ from their checksum; damaged")


def check_texts(file: h5py.File, layers: Iterable[str]) -> None:
    """Compare `text_checksum`.  Raises FactoryError when it differs."""
    if file.attrs[_TEXTS] != _digest(_texts(file, layers)):
        raise FactoryError("units or descriptions differ from their checksum; damaged")


def picture_sums(file: h5py.File) -> npt.NDArray[np.void]:
    """(samples,) `crc32` of each picture, a column a layer."""
    sums: npt.NDArray[np.void] = file[CHECKSUMS][()]
    return sums


def _digest(document: Any) -> str:
    text = json.dumps(document, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _contents(file: h5py.File, rows: npt.NDArray[Any]) -> list[Any]:
    sums = file[CHECKSUMS][()]
    return [
        [[name, _value(file.attrs.get(name))] for name in ROOT_ATTRIBUTES if name not in SEALS],
        [[axis.name, crc32(axis.values)] for axis in image_axes(file["noisy"])],
        *([["echoes", crc32(file[ECHO_PLACE][()])]] if echo_names(file) else []),
        *([[[n, t.dtype[n].str] for n in t.dtype.names or ()], crc32(t)] for t in (rows, sums)),
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
