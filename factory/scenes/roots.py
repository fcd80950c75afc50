"""The `scenes.root` key: what it may be, and one-line errors when it is not what is there."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
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


def folder_name(folder: Path) -> str:
    """The last part of the path, also for `.` and `..`; links keep the name they are known by."""
    return Path(os.path.abspath(folder)).name


def recordings(root: Path, is_recording: Callable[[Path], bool]) -> list[Path]:
    """`root` itself when it is a recording, else the recordings directly inside it, by name."""
    if is_recording(root):
        return [root]
    return [folder for folder in sorted(root.iterdir()) if folder.is_dir() and is_recording(folder)]


def visible_files(folder: Path) -> Iterator[str]:
    """Names of the plain files of a folder, sorted; nothing when the folder is not there.

    Names that start with a dot are left out: archives made on a Mac carry a `._x.tiff` beside
    every `x.tiff`.
    """
    if folder.is_dir():
        with os.scandir(folder) as entries:
            names = [entry.name for entry in entries if entry.is_file()]
        yield from sorted(name for name in names if not name.startswith("."))
