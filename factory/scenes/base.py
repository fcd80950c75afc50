"""What readers of RGBD recordings share: settings, what they find, and the search of folders."""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass as plain_dataclass
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal, Protocol

from pydantic import AfterValidator
from pydantic.dataclasses import dataclass

from ..errors import FactoryError
from ..frame import Frame, FrameRef
from ..settings import STRICT

INTEGERS_PER_M = {"csv_list": 1000.0, "redwood": 1000.0, "tum": 5000.0}
"""scenes.kind -> what integer depth is divided by where `depth_scale` is null."""


def _given(root: str) -> str:
    # "???" is how the YAML files say that the user has to fill a key in.
    if root.strip() in ("", "???"):
        raise ValueError("a path is required, for example scenes.root=../data/flsea-vi")
    return root


Root = Annotated[str, AfterValidator(_given)]


@dataclass(frozen=True, config=STRICT)
class SceneSettings:
    """Keys that all `scenes` kinds have.

    depth_kind: whether the depth files hold z (along the optical axis) or slant range.
    bad_depth: what NaN, infinite and negative depths mean: a bad frame, or an unmeasured pixel.
    """

    depth_kind: Literal["z", "range"] = "z"
    bad_depth: Literal["reject", "mask"] = "reject"

    def own_classes(self) -> tuple[str, ...]:
        """Classes of the user's own objects, beside `labels.CLASSES` or among them."""
        return ()


@plain_dataclass(frozen=True)
class Discovery:
    """What a reader found.

    frames: every usable frame, sorted by (location, scene, frame).
    skipped: reason -> how many images were left out for it (for example no depth map).
    notes: one-line remarks for the user (which scenes are absent, which calibration was used).
    warnings: one line each, about what could not be read and is left out.
    """

    frames: tuple[FrameRef, ...]
    skipped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


class Reader(Protocol):
    """Finds frames and loads them.  Built from settings alone, so a worker can build its own."""

    def discover(self) -> Discovery:
        """List the frames; recordings that cannot be read are left out and told.

        Raises FactoryError when the root is missing, or nothing in it is of use.
        """

    def load(self, ref: FrameRef) -> Frame:
        """Read one frame, checked (`frame.checked`).  Raises FrameError when it is bad."""


def frames_of(reader: Reader) -> tuple[FrameRef, ...]:
    """The frames that `reader` finds; warnings go to stderr.  Raises FactoryError as it does."""
    discovery = reader.discover()
    for line in discovery.warnings:
        print(f"warning: {line}", file=sys.stderr)
    return discovery.frames


class UnreadableError(FactoryError):
    """Something of one recording cannot be read; others may be of use without it."""

    def __init__(self, path: Path, error: OSError) -> None:
        # Nothing within a closed folder can be looked at: the folder is what has to be opened.
        asked = Path(error.filename or path)
        closed = next(part for part in (asked, *asked.parents, path) if os.path.lexists(part))
        super().__init__(
            f"scenes.root: {closed} cannot be read ({error.strerror or error}); make it readable, "
            "or leave that recording out"
        )


@plain_dataclass
class Found:
    """What a reader has found so far; see `Discovery`."""

    frames: list[FrameRef] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)
    closed: dict[str, UnreadableError] = field(default_factory=dict)

    @contextmanager
    def unreadable(self, folder: Path) -> Iterator[None]:
        """Keep an OSError or UnreadableError of the recording in `folder`, and go on after it."""
        try:
            yield
        except UnreadableError as error:
            self.closed.setdefault(str(error), error)
        except OSError as error:
            closed = UnreadableError(folder, error)
            self.closed.setdefault(str(closed), closed)

    def discovery(self, nothing: str) -> Discovery:
        """All of it, sorted.  Without frames, raises the first error, or FactoryError(nothing)."""
        if not self.frames:
            raise next(iter(self.closed.values()), FactoryError(nothing))
        if self.closed:
            self.skipped["whole folder or list that cannot be read"] = len(self.closed)
        return Discovery(
            tuple(sorted(self.frames, key=lambda ref: (ref.location, ref.scene, ref.frame))),
            {reason: count for reason, count in sorted(self.skipped.items()) if count},
            tuple(self.notes),
            tuple(self.closed),
        )


def root_folder(root: str, expected: str) -> Path:
    """The folder `root` (`~` expanded).  Raises FactoryError that tells which folder to give."""
    folder = Path(root).expanduser()
    try:
        exists, is_folder = folder.exists(), folder.is_dir()
    except OSError as error:
        raise UnreadableError(folder, error) from error
    if not is_folder:
        fault = "not a folder" if exists else "no such folder"
        raise FactoryError(f"scenes.root={root}: {fault}; set scenes.root to {expected}")
    return folder


class FolderReader:
    """Finds recordings: the root, or the folders directly inside it.  Each is a scene."""

    root: str
    expected = "a recording"

    def is_recording(self, folder: Path) -> bool:
        """Whether the files of a recording lie in `folder`."""
        raise NotImplementedError

    def scan(self, folder: Path, found: Found) -> None:
        """Add the frames of a recording, the notes about it, and what of it is no use."""
        raise NotImplementedError

    def discover(self) -> Discovery:
        """See `Reader`."""
        root, found = root_folder(self.root, self.expected), Found()
        with found.unreadable(root):
            if self.is_recording(root):
                self.scan(root, found)
            else:
                for folder in sorted(root.iterdir()):
                    with found.unreadable(folder):
                        if folder.is_dir() and self.is_recording(folder):
                            self.scan(folder, found)
        nothing = f"scenes.root={self.root}: no frame found; set scenes.root to {self.expected}"
        return found.discovery(nothing)


def check_some_exist(frames: Sequence[FrameRef], given: str, remedy: str) -> None:
    """Raise FactoryError when none of the listed frames' pictures is there."""
    # Unlike Path.is_file, os.path.isfile raises nothing.
    if not any(os.path.isfile(path) for ref in frames for path in ref.paths[:2]):
        raise FactoryError(
            f"{given}: none of the {len(frames)} frames listed exists, the first is "
            f"{frames[0].paths[0]}; {remedy}"
        )


def folder_name(folder: Path) -> str:
    """The last part of the path, also for `.` and `..`; links keep the name they are known by."""
    return Path(os.path.abspath(folder)).name


def visible_files(folder: Path) -> list[str]:
    """Names of the files of a folder, sorted; nothing when the folder is not there.

    Names that start with a dot are left out: archives made on a Mac carry a `._x.tiff` beside
    every `x.tiff`.  So are links that lead nowhere.  Raises OSError when it cannot be read.
    """
    if not folder.is_dir():
        return []
    with os.scandir(folder) as entries:
        return sorted(one.name for one in entries if one.name[0] != "." and _is_file(one))


def _is_file(entry: os.DirEntry[str]) -> bool:
    try:
        return entry.is_file()
    except OSError as error:
        # What lies behind a link cannot be looked at: a bad frame, which names it.
        return isinstance(error, PermissionError)


def numbered_lines(path: Path) -> list[tuple[int, str]]:
    """(line number, text) of the lines that are neither empty nor comments (`#`).

    Raises UnreadableError when the file cannot be read, FactoryError when it is no text.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UnreadableError(path, error) from error
    except UnicodeDecodeError as error:
        raise FactoryError(f"{path}: not a text file; give the recording's own list") from error
    numbered = enumerate((line.strip() for line in text.splitlines()), start=1)
    return [(number, line) for number, line in numbered if line and not line.startswith("#")]
