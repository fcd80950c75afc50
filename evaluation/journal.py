"""What has been measured already, kept on disk as it comes: an interrupted report goes on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from simnfnd.factory.files import explain_os_errors

Figures = dict[str, float]
JOURNAL_NAME = "measured.jsonl"

_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "scikit-image")
_METRICS = (
    "metrics/checks", "metrics/edges", "metrics/levels", "metrics/measure", "metrics/fidelity",
    "metrics/multiscale", "metrics/reference", "metrics/speckle", "metrics/texture", "pictures",
    "work",
)  # fmt: skip


class Journal:
    """Figures by (method, picture), appended line by line to a file.

    A line that was cut off by a crash is left out.  A key holds everything that decides the
    figures, so lines of another program, picture or parameter are never found again.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / JOURNAL_NAME
        self._known: dict[tuple[str, str], Figures] = {}
        with explain_os_errors(folder, "out"):
            folder.mkdir(parents=True, exist_ok=True)
            # Opened now, so that a folder that cannot be written to ends the run before its work.
            self._file = self._path.open("a+b")
        self._file.seek(0)
        content = self._file.read()
        for line in content.splitlines():
            self._read(line)
        if content and not content.endswith(b"\n"):
            self._file.write(b"\n")

    def get(self, method: str, picture: str) -> Figures | None:
        """What is known of a method on a picture."""
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
        with explain_os_errors(self._path, "out"):
            self._file.write(json.dumps(line).encode() + b"\n")
            self._file.flush()
        self._keep(line)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _read(self, line: bytes) -> None:
        try:
            self._keep(json.loads(line))
        except (ValueError, KeyError, TypeError):
            return  # cut off, or not ours: measured again

    def _keep(self, line: dict[str, Any]) -> None:
        for picture, values in zip(line["pictures"], line["figures"], strict=True):
            self._known[line["method"], picture] = dict(zip(line["names"], values, strict=True))


def program_digest() -> str:
    """Changes with the program of the metrics and with the libraries that they use."""
    digest = hashlib.blake2b(digest_size=12)
    for name in _METRICS:
        digest.update((Path(__file__).parent / f"{name}.py").read_bytes())
    for library in _LIBRARIES:
        try:
            digest.update(f"{library} {metadata.version(library)}".encode())
        except metadata.PackageNotFoundError:
            continue
    return digest.hexdigest()
