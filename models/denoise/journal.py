"""What is finished in an output folder, so that no run does it again; and that a run is alone.

The journal is a file of lines, one for each finished file: by which command and from what it was
made, and what came of it.  A result counts while it, its source and the command are the same.  The
journal has its whole length from the start of a run, so that a full disk cannot keep the run from
noting what it finished, and a run that is killed between two lines loses neither.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from filelock import FileLock, Timeout

from ...factory.common.errors import FactoryError
from ...factory.common.files import explain_os_errors, write_atomically
from ..recordings import dataset_of
from ..recordings.inputs import InputFile

JOURNAL_NAME = ".denoise-finished"
LOCK_NAME = ".denoise-lock"
_ASKING_S = 0.2
_USUAL_BYTES = 1200  # of a line without names


@dataclass(frozen=True)
class Entry:
    """A finished file.

    name: of the item, below the output folder.  key: of the command and of the sources of its
    sequence.  result: name of the file that was written, which may have another suffix.
    state: of the result on disk.  row: of the table.
    """

    name: str
    key: str
    result: str
    state: str
    row: dict[str, Any] = field(default_factory=dict)


class Journal:
    """The finished files of an output folder; see `opened_journal`."""

    def __init__(self, out: Path, command: object, verb: str = "denoise") -> None:
        """command: all that decides on the bytes of results but for the inputs, of JSON's types.

        verb: of the command line, whose journal this is.
        """
        self._out = out
        self._path = out / JOURNAL_NAME.replace("denoise", verb)
        self._command = json.dumps(command, sort_keys=True)
        self._entries = self._read()
        self._keys: dict[Path, str] = {}
        self._file: IO[bytes] | None = None

    def __contains__(self, item: InputFile) -> bool:
        """Whether this command has denoised a file as it is now, and its result is there."""
        entry = self._entries.get(str(item.relative))
        if entry is None or entry.key != self.key(item):
            return False
        return _state_of(self._out / entry.result) == entry.state

    def begin_anew(self) -> None:
        """Count nothing as finished."""
        self._entries.clear()

    def begin(self, sequences: Sequence[Sequence[InputFile]], *, in_time: bool) -> None:
        """Make room for all files.  Raises FactoryError when there is none.

        in_time: whether a file's result depends on the others of its sequence.
        """
        for items in sequences:
            states = [(str(item.relative), _source_state(item)) for item in items]
            for item, state in zip(items, states, strict=True):
                said = json.dumps([self._command, states if in_time else state])
                self._keys[item.relative] = hashlib.sha256(said.encode()).hexdigest()
        left = [item for items in sequences for item in items if item not in self]
        for item in left:
            self._entries.pop(str(item.relative), None)
        head = "".join(map(_line_of, self._entries.values())).encode()
        room = sum(2 * len(json.dumps(str(item.relative))) + _USUAL_BYTES for item in left)
        write_atomically(self._path, head + b" " * room, key="--out")
        with explain_os_errors(self._path, "--out"):
            self._file = self._path.open("r+b")
            self._file.seek(len(head))

    def key(self, item: InputFile) -> str:
        """Key of the command and the sources that decide the result of an item."""
        return self._keys.get(item.relative, "")

    def add(self, item: InputFile, row: dict[str, Any], result: Path | None = None) -> None:
        """Record a denoised file.

        row: its row of the table.  result: the file written, where it has another name.
        """
        path = result or self._out / item.relative
        name = os.path.relpath(path, self._out)
        entry = Entry(str(item.relative), self.key(item), name, _state_of(path), row)
        self._entries[entry.name] = entry
        if self._file is not None:
            self._file.write(_line_of(entry).encode())
            self._file.flush()

    def amend(self, item: InputFile, columns: dict[str, Any]) -> None:
        """Say more of a finished file, once its sequence is at its end."""
        entry = self._entries.get(str(item.relative))
        if entry is not None:
            entry.row.update(columns)

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows of all results that are there, by their names."""
        for _, entry in sorted(self._entries.items()):
            if entry.row and (self._out / entry.result).exists():
                yield entry.row

    def row(self, item: InputFile) -> dict[str, Any]:
        """The row of a finished file."""
        return self._entries[str(item.relative)].row

    def finish(self) -> None:
        """The run came to its end: keep the lines alone."""
        self.close()
        lines = "".join(_line_of(entry) for _, entry in sorted(self._entries.items()))
        write_atomically(self._path, lines.encode(), key="--out")

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def _read(self) -> dict[str, Entry]:
        """The entries by name; lines that are cut off or of other versions count for nothing."""
        try:
            lines = self._path.read_text(encoding="utf-8").splitlines()
        except (OSError, ValueError):  # none, or no text
            return {}
        entries = {}
        for line in lines:
            with suppress(ValueError, TypeError):
                entry = Entry(**json.loads(line))
                entries[entry.name] = entry
        return entries


def _line_of(entry: Entry) -> str:
    return json.dumps(entry.__dict__) + "\n"


def _source_state(item: InputFile) -> str:
    dataset = dataset_of(item.source) if not item.source.exists() else None
    if dataset is not None:  # a recording in a dataset
        return _state_of_files(sorted(dataset.rglob("*.h5")))
    return _state_of(item.source)


def _state_of(path: Path) -> str:
    """What changes when a file or folder is written again; empty where there is none."""
    if path.is_dir():
        return _state_of_files(sorted(file for file in path.iterdir() if file.is_file()))
    return _state_of_files([path]) if path.exists() else ""


def _state_of_files(files: Iterable[Path]) -> str:
    states = []
    for file in files:
        status = file.stat()
        states.append((file.name, status.st_size, status.st_mtime_ns))
    return hashlib.sha256(json.dumps(states).encode()).hexdigest()[:32]


@contextmanager
def opened_journal(out: Path, command: object, verb: str = "denoise") -> Iterator[Journal]:
    """The journal of an output folder, in which no other run writes within the block.

    command, verb: see `Journal`.  Raises FactoryError when another run does.
    """
    path = out / LOCK_NAME.replace("denoise", verb)
    lock = FileLock(path)
    is_locked = False
    try:
        lock.acquire(timeout=_ASKING_S, poll_interval=0.05)
        is_locked = True
        path.write_text(str(os.getpid()), encoding="ascii")
    except Timeout:
        raise FactoryError(
            f"--out {out}: process {_owner(path)} is writing into this folder; wait for it, or "
            "give another --out"
        ) from None
    except OSError:
        pass  # a file system without locks
    journal = Journal(out, command, verb)
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
