"""A run of `denoise` that was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from pathlib import Path

from ...factory.files import write_atomically
from .inputs import Item

NAME = ".denoise-stopped.json"
"""In the output folder, of a run that was stopped."""


class Finished:
    """Which files are denoised, kept where a run is stopped and for the same command alone."""

    def __init__(self, out: Path, digest: str, arguments: Sequence[str]) -> None:
        """digest: of the weights.  arguments: of the command."""
        self._path = out / NAME
        whole = json.dumps([digest, *arguments])
        self._command = hashlib.sha256(whole.encode()).hexdigest()
        self._done: dict[str, list[int]] = {}

    def of(self, items: Sequence[Item]) -> frozenset[Path]:
        """Results of the run that was stopped, of files that did not change since."""
        try:
            kept = json.loads(self._path.read_bytes())
            done = dict(kept["done"]) if kept["command"] == self._command else {}
        except (OSError, ValueError, TypeError, KeyError):
            return frozenset()
        found = [
            item.relative
            for item in items
            if done.get(str(item.relative)) == _state(item)
            and (self._path.parent / item.relative).exists()
        ]
        self._done = {str(relative): done[str(relative)] for relative in found}
        return frozenset(found)

    def add(self, item: Item) -> None:
        """A file is denoised."""
        self._done[str(item.relative)] = _state(item)

    def save(self) -> None:
        """The run is stopped."""
        content = json.dumps({"command": self._command, "done": self._done})
        write_atomically(self._path, content.encode(), key="--out")

    def forget(self) -> None:
        """The run came to its end."""
        self._path.unlink(missing_ok=True)


def _state(item: Item) -> list[int]:
    try:
        found = item.source.stat()
    except OSError:
        return []
    return [found.st_size, found.st_mtime_ns]
