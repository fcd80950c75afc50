"""Denoised frames on disk before their file can be written: one record after the other.

Most containers cannot be continued.  So finished frames are kept here, encoded where that takes
time, and joined at the end.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

_LENGTHS = struct.Struct("<IQ")


class Record(NamedTuple):
    """What is said of a frame, of JSON's types, and its bytes."""

    header: dict[str, Any]
    content: bytes


class Spool:
    """A file of records that grows; see the module.  It appears with its first record."""

    def __init__(self, path: Path, length: int = 0) -> None:
        """length: bytes that count; what was written behind them goes."""
        self._path = path
        self.length = length
        if path.exists():
            os.truncate(path, length)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("ab")

    def append(self, header: Mapping[str, Any], content: bytes | memoryview) -> None:
        """Add a record.  Raises OSError."""
        said = json.dumps(header).encode()
        size = memoryview(content).nbytes
        self._file.write(_LENGTHS.pack(len(said), size))
        self._file.write(said)
        self._file.write(content)
        self.length += _LENGTHS.size + len(said) + size

    def sync(self) -> None:
        """Wait until the disk has all records.  Raises OSError."""
        self._file.flush()
        os.fsync(self._file.fileno())

    def __iter__(self) -> Iterator[Record]:
        self._file.flush()
        with self._path.open("rb") as file:
            while file.tell() < self.length:
                said_size, size = _LENGTHS.unpack(file.read(_LENGTHS.size))
                header = json.loads(file.read(said_size))
                yield Record(header, file.read(size))

    def close(self) -> None:
        """Close the file, which stays on disk."""
        self._file.close()
