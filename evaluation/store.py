"""Figures that are known from an earlier run, and the keys under which they are found again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from functools import lru_cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..factory.files import explain_os_errors
from .metrics.measure import Figures

STORE_NAME = "measured.jsonl"

_LIBRARIES = (
    "numpy", "scipy", "opencv-python-headless", "scikit-image", "torch", "onnxruntime",
)  # fmt: skip
_ROOM = Path(__file__).parent
# Wider than need be: a digest that is too narrow would let old figures pass for new ones.
_SOURCES = (
    _ROOM,
    _ROOM.parent / "models",
    _ROOM.parent / "factory" / "dataset",
    _ROOM.parent / "factory" / "sonar",
)


@lru_cache(maxsize=4)
def program_digest(device: str) -> str:
    """Changes with the code, the libraries and the device that decide figures.

    device: auto, cpu or gpu, as in the settings.
    """
    known = {one.name: one.version for one in metadata.distributions() if one.name in _LIBRARIES}
    parts = [sources_digest(*_SOURCES), *sorted(known.items()), _device_kind(device)]
    return hashlib.blake2b(repr(parts).encode(), digest_size=12).hexdigest()


def sources_digest(*folders: Path) -> str:
    """Changes with every Python file below these folders, and its name."""
    digest = hashlib.blake2b(digest_size=12)
    for folder in folders:
        for file in sorted(folder.resolve().rglob("*.py")):
            digest.update(file.relative_to(folder.resolve()).as_posix().encode() + b"\n")
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _device_kind(device: str) -> str:
    if device == "cpu" or find_spec("torch") is None:
        return device
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu"


class FigureStore:
    """Figures by (method key, picture key), appended line by line to a file as they are measured.

    The keys cover everything that decides the figures, so figures of other code, another picture
    or other parameters are never found.  A line that a crash cut off is measured again.
    """

    def __init__(self, folder: Path) -> None:
        """Open, or begin, the file in a folder; FactoryError for a folder that is no use."""
        self._known: dict[tuple[str, str], Figures] = {}
        self._path = folder / STORE_NAME
        with explain_os_errors(folder, "out"):
            folder.mkdir(parents=True, exist_ok=True)
            # Opened now, so that a folder that cannot be written to ends the run before its work.
            self._file = self._path.open("a+b")
        self._file.seek(0)
        content = self._file.read()
        if content and not content.endswith(b"\n"):
            self._file.write(b"\n")
        for line in content.splitlines():
            try:
                self._keep(json.loads(line))
            except (ValueError, KeyError, TypeError):
                continue  # cut off, or not ours

    def get(self, method: str, picture: str) -> Figures | None:
        """The figures of a method on a picture, None when they have not been measured."""
        return self._known.get((method, picture))

    def add(self, method: str, pictures: Sequence[str], figures: Sequence[Figures]) -> None:
        """Keep the figures of a method on these pictures; written at once."""
        line = {"method": method, "pictures": list(pictures), "figures": list(figures)}
        with explain_os_errors(self._path, "out"):
            self._file.write(json.dumps(line).encode() + b"\n")
            self._file.flush()
        self._keep(line)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _keep(self, line: dict[str, Any]) -> None:
        for picture, figures in zip(line["pictures"], line["figures"], strict=True):
            self._known[line["method"], picture] = dict(figures)
