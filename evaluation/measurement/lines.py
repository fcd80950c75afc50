"""A file of JSON, a value a line, that grows as work is done: what was done is found again."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...factory.files import explain_os_errors


class LineFile:
    """Lines that were there, and more at the end, each written at once."""

    def __init__(self, folder: Path, name: str) -> None:
        """Open, or begin, the file of this name; FactoryError for a folder that is no use."""
        self._path = folder / name
        with explain_os_errors(folder, "out"):
            folder.mkdir(parents=True, exist_ok=True)
            # Opened now, so that a folder that cannot be written to ends the run before its work.
            self._file = self._path.open("a+b")
        self._file.seek(0)
        content = self._file.read()
        # Whatever they hold; the last may have been cut off by a crash.
        self.lines = content.splitlines()
        if content and not content.endswith(b"\n"):
            self._file.write(b"\n")

    def add(self, value: Any) -> None:
        """Write one value as JSON; FactoryError when it cannot be written."""
        with explain_os_errors(self._path, "out"):
            self._file.write(json.dumps(value).encode() + b"\n")
            self._file.flush()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
