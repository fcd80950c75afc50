"""Figures on disk, written as they are measured: an interrupted report goes on from them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .lines import LineFile

Figures = dict[str, float]
MEASURED_NAME = "measured.jsonl"


class FigureStore:
    """Figures by (method key, picture key), appended line by line to a file.

    The keys cover everything that decides the figures (see `fingerprint`), so figures of other
    code, another picture or other parameters are never found.  A line that a crash cut off is
    ignored.
    """

    def __init__(self, folder: Path) -> None:
        self._known: dict[tuple[str, str], Figures] = {}
        self._file = LineFile(folder, MEASURED_NAME)
        for line in self._file.lines:
            self._read(line)

    def get(self, method: str, picture: str) -> Figures | None:
        """The figures of a method on a picture, None when they have not been measured."""
        return self._known.get((method, picture))

    def add(self, method: str, pictures: Sequence[str], figures: Sequence[Figures]) -> None:
        """Keep the figures of a method on these pictures; written at once."""
        names = list(figures[0])
        line = {
            "method": method,
            "pictures": list(pictures),
            "names": names,
            "figures": [[one[name] for name in names] for one in figures],
        }
        self._file.add(line)
        self._keep(line)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read(self, line: bytes) -> None:
        try:
            self._keep(json.loads(line))
        except (ValueError, KeyError, TypeError):
            return  # cut off, or not ours: it is measured again

    def _keep(self, line: dict[str, Any]) -> None:
        for picture, values in zip(line["pictures"], line["figures"], strict=True):
            self._known[line["method"], picture] = dict(zip(line["names"], values, strict=True))
