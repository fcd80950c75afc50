"""What a run keeps of a recording that is not finished: its state and its finished frames.

They lie in the output folder until the recording is written.  A run that is interrupted, killed or
out of disk goes on from there, to the bytes of an undisturbed run: states are kept after the same
frames by every run.
"""

from __future__ import annotations

import hashlib
import shutil
from contextlib import suppress
from pathlib import Path
from typing import Any

from ...factory.common.files import explain_os_errors, write_atomically
from .checkpoint import packed, unpacked
from .spool import Spool

FOLDER = ".denoise-unfinished"
INTERVAL = 16
"""Frames between two states: they cost a hundredth of what the frames cost."""


class Unfinished:
    """The place of one recording.

    key: of the command and of the recording as it is now: states of others do not count.
    """

    def __init__(self, out: Path, name: str, key: str) -> None:
        """out: the output folder.  name: of the result below it."""
        self._parent = out / FOLDER
        self._folder = self._parent / hashlib.sha256(name.encode()).hexdigest()[:16]
        self._key = key
        self._spool: Spool | None = None

    def load(self) -> dict[str, Any] | None:
        """The last state that was kept; None where there is none that fits."""
        with suppress(OSError, ValueError):
            state: dict[str, Any] = unpacked(self._state_path.read_bytes())
            if state["key"] == self._key and self._spooled() >= state["spooled"]:
                return state
        return None

    def open_spool(self, length: int = 0) -> Spool:
        """Open the spool and cut it to `length` bytes.  Raises FactoryError."""
        with explain_os_errors(self._folder, "--out"):
            self._spool = Spool(self._folder / "frames", length)
        return self._spool

    def save(self, state: dict[str, Any]) -> None:
        """Keep a state, and all that was spooled until now.  Raises FactoryError."""
        spooled = 0
        with explain_os_errors(self._folder, "--out"):
            self._folder.mkdir(parents=True, exist_ok=True)
            if self._spool is not None:
                self._spool.sync()
                spooled = self._spool.length
        content = packed({**state, "key": self._key, "spooled": spooled})
        write_atomically(self._state_path, content, key="--out")

    def close(self) -> None:
        """Close the files."""
        if self._spool is not None:
            self._spool.close()

    def remove(self) -> None:
        """Delete what was kept, once the recording is written or cannot be."""
        self.close()
        shutil.rmtree(self._folder, ignore_errors=True)
        with suppress(OSError):  # it holds other recordings
            self._parent.rmdir()

    @property
    def _state_path(self) -> Path:
        return self._folder / "state"

    def _spooled(self) -> int:
        with suppress(OSError):
            return (self._folder / "frames").stat().st_size
        return 0
