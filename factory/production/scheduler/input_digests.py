"""Hashes of frames' files, kept from run to run so that unchanged files are not read again."""

from __future__ import annotations

import hashlib
import json
import os
import threading
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...common.errors import FactoryError
from ...common.files import write_atomically
from ...common.small_files import open_regular, parse_json, read_regular

_NS = 1_000_000_000
# A file that was written a moment ago may be written again within one tick of its times.
_SETTLED_NS = 2 * _NS
_FIELDS = 5


class InputDigests:
    """SHA-256 digests of files by path; a file is read again when its size, times or inode differ.

    The time of change counts, too: tools may set the time of modification, but not this one.
    """

    def __init__(self, table_path: Path | None) -> None:
        """table_path: where they are kept; None keeps none.  A damaged table counts for nothing."""
        self._table_path = table_path
        self._lock = threading.Lock()
        self._known: dict[str, list[Any]] = {}
        self._has_changed = False
        if table_path is None:
            return
        with suppress(OSError, ValueError):
            stored = parse_json(read_regular(table_path))
            if isinstance(stored, dict) and all(map(_is_entry, stored.values())):
                self._known = stored

    def digest(self, path: str) -> str:
        """32 hexadecimal digits of a file's content; empty for a file that cannot be read."""
        place = os.path.abspath(path)
        with suppress(OSError), open_regular(Path(path)) as file:
            status = os.fstat(file.fileno())
            state = [status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino]
            entry = self._known.get(place)
            if entry is not None and entry[:-1] == state:
                return str(entry[-1])

            digest = hashlib.file_digest(file, "sha256").hexdigest()[:32]  # type: ignore[arg-type]
            if time.time_ns() - max(status.st_mtime_ns, status.st_ctime_ns) > _SETTLED_NS:
                with self._lock:
                    self._known[place] = [*state, digest]
                    self._has_changed = True
            return digest
        return ""

    def save(self) -> None:
        """Keep what was computed, where the folder can be written."""
        if self._table_path is None or not self._has_changed:
            return
        text = json.dumps(self._known, separators=(",", ":"))
        with suppress(FactoryError):
            write_atomically(self._table_path, text.encode(), durable=False)
        self._has_changed = False


def _is_entry(entry: object) -> bool:
    """Whether a value of the table is size, two times, inode and digest."""
    if not isinstance(entry, list) or len(entry) != _FIELDS or not isinstance(entry[-1], str):
        return False
    return all(isinstance(number, int) for number in entry[:-1])
