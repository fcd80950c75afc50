"""What a run has finished in its output folder, so that the next one goes on, and that it is alone.

The journal is a file whose first line names the command; each later line names a finished file.  It
has its whole length from the start, so that a full disk cannot keep the run from noting what it
finished, and a run that is killed between two lines loses neither.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from filelock import FileLock, Timeout

from ...factory.common.errors import FactoryError
from ...factory.common.files import explain_os_errors, write_atomically
from ..recordings.inputs import Item

JOURNAL_NAME = ".denoise-finished"
LOCK_NAME = ".denoise-lock"
_ASKING_S = 0.2


class Journal:
    """The finished files of one command in one output folder.

    See `opened_journal`.  An item counts as finished while its result is there.
    """

    def __init__(self, out: Path, digest: str, arguments: Sequence[str]) -> None:
        """digest: of the weights.  arguments: of the command."""
        self._out = out
        self._path = out / JOURNAL_NAME
        command = json.dumps([digest, *arguments]).encode()
        self._header = json.dumps({"command": hashlib.sha256(command).hexdigest()})
        self._finished = self._read()
        self._file: IO[bytes] | None = None

    def __contains__(self, item: Item) -> bool:
        """Whether a file was denoised by this command, and its result is there."""
        return str(item.relative) in self._finished and (self._out / item.relative).exists()

    def begin_anew(self) -> None:
        """Count nothing as finished."""
        self._finished.clear()

    def begin(self, items: Sequence[Item]) -> None:
        """Make room for the names of all items.  Raises FactoryError when there is none."""
        names = [str(item.relative) for item in items]
        finished = [name for name in names if name in self._finished]
        left = [name for name in names if name not in self._finished]
        head = "".join(f"{line}\n" for line in (self._header, *map(json.dumps, finished))).encode()
        room = sum(len(json.dumps(name)) + 1 for name in left)
        write_atomically(self._path, head + b" " * room, key="--out")
        with explain_os_errors(self._path, "--out"):
            self._file = self._path.open("r+b")
            self._file.seek(len(head))

    def add(self, item: Item) -> None:
        """A file is denoised."""
        name = str(item.relative)
        if name in self._finished:
            return
        self._finished.add(name)
        if self._file is not None:
            self._file.write(f"{json.dumps(name)}\n".encode())
            self._file.flush()

    def forget(self) -> None:
        """The run came to its end: the next one begins anew."""
        self.close()
        self._path.unlink(missing_ok=True)

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _read(self) -> set[str]:
        """Names of the files that this very command finished."""
        try:
            header, *lines = self._path.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):  # none, an empty one, or no text
            return set()
        names = set[str]()
        if header == self._header:
            for line in lines:
                with suppress(ValueError):  # the room that is left, or a line that was cut off
                    names.add(str(json.loads(line)))
        return names


@contextmanager
def opened_journal(out: Path, digest: str, arguments: Sequence[str]) -> Iterator[Journal]:
    """The journal of an output folder, in which no other run writes within the block.

    Raises FactoryError when one does.
    """
    path = out / LOCK_NAME
    lock = FileLock(path)
    is_locked = False
    try:
        lock.acquire(timeout=_ASKING_S, poll_interval=0.05)
        is_locked = True
        path.write_text(str(os.getpid()), encoding="ascii")
    except Timeout:
        raise FactoryError(
            f"--out {out}: process {_owner(path)} is denoising into this folder; wait for it, or "
            "give another --out"
        ) from None
    except OSError:
        pass  # a file system without locks
    journal = Journal(out, digest, arguments)
    try:
        yield journal
    finally:
        journal.close()
        if is_locked:
            # Removed while held: a waiting process finds the file missing and creates another.
            with suppress(OSError):
                path.unlink()
            lock.release()


def _owner(path: Path) -> str:
    """The number of the process that holds the lock."""
    with suppress(OSError, ValueError):
        return str(int(path.read_text(encoding="ascii")))
    return "?"
