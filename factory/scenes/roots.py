"""The `scenes.root` key: what it may be, and one-line errors when it is not what is there."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

from ..errors import FactoryError

# What the process lacks: every other folder would fail as well.
_OF_THE_PROCESS = {errno.EMFILE, errno.ENFILE, errno.ENOMEM}


def _given(root: str) -> str:
    # "???" is how the YAML files say that the user has to fill a key in.
    if root.strip() in ("", "???"):
        raise ValueError("a path is required, for example scenes.root=../data/flsea-vi")
    return root


Root = Annotated[str, AfterValidator(_given)]


def root_folder(root: str, expected: str) -> Path:
    """The folder `root` (`~` expanded).  Raises FactoryError that tells which folder to give."""
    folder = Path(root).expanduser()
    with listing(folder):
        exists, is_folder = folder.exists(), folder.is_dir()
    if not exists:
        raise FactoryError(f"scenes.root={root}: no such folder; set scenes.root to {expected}")
    if not is_folder:
        raise FactoryError(f"scenes.root={root}: not a folder; set scenes.root to {expected}")
    return folder


class UnreadableError(FactoryError):
    """Something of one recording may not or cannot be read; others may be of use without it."""

    def __init__(self, path: Path, reason: str) -> None:
        self.what = f"scenes.root: {path} cannot be read ({reason})"
        super().__init__(f"{self.what}; make it readable, or leave that recording out")


class LeftOut:
    """What of a root could not be read, while the recordings beside it serve."""

    def __init__(self) -> None:
        self._errors: dict[str, UnreadableError] = {}

    @contextmanager
    def unreadable(self, folder: Path) -> Iterator[None]:
        """Keep an OSError or UnreadableError of the recording in `folder`, and go on after it."""
        try:
            with listing(folder):
                yield
        except UnreadableError as error:
            self._errors.setdefault(error.what, error)

    def check(self) -> None:
        """Raise the first of the errors, if there was one: for a root of which nothing remains."""
        for error in self._errors.values():
            raise error

    @property
    def skipped(self) -> dict[str, int]:
        """See `Discovery.skipped`."""
        count = len(self._errors)
        return {"whole folder or list that cannot be read": count} if count else {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """See `Discovery.warnings`."""
        return tuple(
            f"{what}; what needs it is left out, make it readable to use it"
            for what in self._errors
        )


@contextmanager
def listing(folder: Path) -> Iterator[None]:
    """Turn an OSError while `folder` is searched into an UnreadableError of what is closed."""
    try:
        yield
    except OSError as error:
        if error.errno in _OF_THE_PROCESS:
            raise
        path = Path(error.filename or folder)
        # Nothing within a closed folder can be looked at: the folder is what has to be opened.
        there = next((part for part in (path, *path.parents) if _can_be_looked_at(part)), path)
        raise UnreadableError(there, error.strerror or str(error)) from error


def _can_be_looked_at(path: Path) -> bool:
    try:
        path.lstat()
    except OSError:
        return False
    return True


def is_there(path: str) -> bool:
    """Whether a listed file exists and may be looked at."""
    return os.path.isfile(path)  # unlike Path.is_file it raises nothing


def folder_name(folder: Path) -> str:
    """The last part of the path, also for `.` and `..`; links keep the name they are known by."""
    return Path(os.path.abspath(folder)).name


def recordings(root: Path, is_recording: Callable[[Path], bool], left_out: LeftOut) -> list[Path]:
    """`root` itself when it is a recording, else the recordings directly inside it, by name.

    Folders that cannot be read are kept in `left_out`.
    """
    found: list[Path] = []
    with left_out.unreadable(root):
        if is_recording(root):
            return [root]
        for path in sorted(root.iterdir()):
            with left_out.unreadable(path):
                if path.is_dir() and is_recording(path):
                    found.append(path)
    return found


def visible_files(folder: Path) -> Iterator[str]:
    """Names of the plain files of a folder, sorted; nothing when the folder is not there.

    Names that start with a dot are left out: archives made on a Mac carry a `._x.tiff` beside
    every `x.tiff`.  So are links that lead nowhere or in a circle.
    Raises FactoryError when the folder cannot be read.
    """
    with listing(folder):
        if not folder.is_dir():
            return
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries if _is_file(entry)]
    yield from sorted(name for name in names if not name.startswith("."))


def _is_file(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_file()
    except OSError as error:
        # What lies behind a link cannot be looked at: a bad frame, which names it.
        return error.errno != errno.ELOOP
