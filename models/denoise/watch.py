"""`simnfnd denoise --watch`: files are denoised as they come into a folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from ...factory.errors import FactoryError
from ..recordings import Levels
from .inputs import Item, items_below

State = tuple[tuple[str, int, int], ...]
"""Name, size and time of change (ns) of a file, or of each file of a bag's folder."""


class Watched:
    """A folder that files come into.

    A file is whole when two looks find it with the same size and time of change.  It is given out
    once, and again when it has changed; not at all when its result is younger than it is.
    """

    def __init__(self, folder: Path, out: Path, levels: Levels | None = None) -> None:
        """levels: of files of arrays.

        Raises FactoryError when there is no such folder, or it is that of the results.
        """
        if not folder.is_dir():
            raise FactoryError(f"--watch {folder}: no such folder")
        if folder.resolve() == out.resolve():
            raise FactoryError(f"--out {out}: is the folder that is watched; give another one")
        self.folder, self.out, self.levels = folder, out, levels
        self._seen: dict[Path, State] = {}
        self._given: dict[Path, State] = {}

    def look(self) -> list[Item]:
        """The items that are whole and were not given out yet, the oldest first."""
        seen: dict[Path, State] = {}
        ready: list[tuple[int, Item]] = []
        for item in items_below(self.folder, self.out):
            if any(part.startswith(".") for part in item.relative.parts):
                continue  # what programs that copy call a file until it is whole
            try:
                state = _state(item.source)
            except OSError:
                continue  # gone again
            seen[item.source] = state
            if state == self._seen.get(item.source) and state != self._given.get(item.source):
                self._given[item.source] = state
                changed_ns = max((change for _, _, change in state), default=0)
                if not _is_younger(self.out / item.relative, changed_ns):
                    ready.append((changed_ns, replace(item, levels=self.levels)))
        self._seen = seen
        return [item for _, item in sorted(ready, key=lambda one: (one[0], one[1].relative))]


def watch(
    watched: Watched,
    work: Callable[[Item], object],
    every_s: float,
    sleep: Callable[[float], object] = time.sleep,
) -> None:
    """Look, work, sleep and so on, until Ctrl-C; the file that is worked on then is left undone."""
    item: Item | None = None
    try:
        while True:
            for item in watched.look():
                work(item)
            item = None
            sleep(every_s)
    except KeyboardInterrupt:
        if item is not None and (watched.out / item.relative).is_dir():
            # A folder of half of its pictures must not pass for a result.
            os.utime(watched.out / item.relative, (0, 0))


def _state(path: Path) -> State:
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    stats = [(file.name, file.stat()) for file in files]
    return tuple((name, stat.st_size, stat.st_mtime_ns) for name, stat in stats)


def _is_younger(result: Path, changed_ns: int) -> bool:
    try:
        return result.stat().st_mtime_ns > changed_ns
    except OSError:
        return False
