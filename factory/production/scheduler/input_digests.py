"""Hashes of frames' files, kept from run to run so that unchanged files are not read again."""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import suppress
from pathlib import Path

from ...common.errors import FactoryError
from ...common.files import write_atomically
from ...common.small_files import open_regular, parse_json, read_regular


class InputDigests:
    """SHA-256 digests of files; a file is read again when its size, times or inode differ.

    The time of change counts, too: tools may set the time of modification, but not this one.
    """

    def __init__(self, table_path: Path | None) -> None:
        """table_path: where they are kept; None keeps none.  A damaged table counts for nothing."""
        self._table_path = table_path
        self._stored: dict[str, str] = {}
        self._used: dict[str, str] = {}
        if table_path is not None:
            with suppress(OSError, ValueError, TypeError):
                self._stored = dict(parse_json(read_regular(table_path)))

    def digest(self, path: str) -> str:
        """32 hexadecimal digits of a file's content; empty for a file that cannot be read."""
        with suppress(OSError), open_regular(Path(path)) as file:
            status = os.fstat(file.fileno())
            times = f"{status.st_mtime_ns} {status.st_ctime_ns}"
            state = f"{os.path.abspath(path)} {status.st_size} {times} {status.st_ino}"
            digest = self._stored.get(state)
            if digest is None:
                digest = hashlib.file_digest(file, "sha256").hexdigest()[:32]  # type: ignore[arg-type]
            self._used[state] = digest
            return digest
        return ""

    def save(self) -> None:
        """Keep those of this run, where the folder can be written."""
        if self._table_path is None or self._used == self._stored:
            return
        text = json.dumps(self._used, separators=(",", ":"))
        with suppress(FactoryError):
            write_atomically(self._table_path, text.encode(), durable=False)
