"""The `scenes.root` key: what it may be, and one-line errors when it is not what is there."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator

from simnfnd.factory.errors import FactoryError


def _given(root: str) -> str:
    # "???" is how the YAML files say that the user has to fill a key in.
    if root.strip() in ("", "???"):
        raise ValueError("a path is required, for example scenes.root=../data/flsea-vi")
    return root


Root = Annotated[str, AfterValidator(_given)]


def root_folder(root: str, expected: str) -> Path:
    """The folder `root` (`~` expanded).  Raises FactoryError that tells which folder to give."""
    folder = Path(root).expanduser()
    if not folder.exists():
        raise FactoryError(f"scenes.root={root}: no such folder; set scenes.root to {expected}")
    if not folder.is_dir():
        raise FactoryError(f"scenes.root={root}: not a folder; set scenes.root to {expected}")
    return folder


@contextmanager
def listing(folder: Path) -> Iterator[None]:
    """Turn an OSError while `folder` is searched into a FactoryError of one line."""
    try:
        yield
    except OSError as error:
        path = error.filename or folder
        raise FactoryError(
            f"scenes.root: {path} cannot be read ({error.strerror}); make it readable, or leave "
            "that recording out"
        ) from error


def folder_name(folder: Path) -> str:
    """The last part of the path, also for `.` and `..`; links keep the name they are known by."""
    return Path(os.path.abspath(folder)).name


def recordings(root: Path, is_recording: Callable[[Path], bool]) -> list[Path]:
    """`root` itself when it is a recording, else the recordings directly inside it, by name.

    Raises FactoryError when a folder cannot be read.
    """
    with listing(root):
        if is_recording(root):
            return [root]
        return [path for path in sorted(root.iterdir()) if path.is_dir() and is_recording(path)]


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
        if error.errno == errno.ELOOP:
            return False
        raise
