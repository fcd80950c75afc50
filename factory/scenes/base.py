"""What readers of RGBD recordings share: settings, what they find, and the search of folders."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass as plain_dataclass
from dataclasses import field
from pathlib import Path
from typing import Annotated, Literal, Protocol

from pydantic import AfterValidator, ConfigDict, Field
from pydantic.dataclasses import dataclass

from ..errors import FactoryError
from ..frame import Frame, FrameRef
from ..settings import STRICT, ClassName

INTEGERS_PER_M = 1000.0
"""What integer depth is divided by where `depth_scale` is null: millimetres."""


def _given(root: str) -> str:
    # "???" is how the YAML files say that the user has to fill a key in.
    if root.strip() in ("", "???"):
        raise ValueError("a path is required, for example scenes.root=../data/flsea-vi")
    return root


Root = Annotated[str, AfterValidator(_given)]


@dataclass(frozen=True, config=ConfigDict(**STRICT, serialize_by_alias=True), kw_only=True)
class OwnClass:
    """What the user says of a class of objects.

    class: what it is called in labels; a name of `labels.CLASSES`, or a new one.
    reflectivity_db, lambert_exponent: see `AcousticsSettings`; None: not said here.
    """

    label: Annotated[ClassName, Field(alias="class")]
    reflectivity_db: Annotated[float, Field(ge=-80, le=20)] | None = None
    lambert_exponent: Annotated[float, Field(ge=0, le=8)] | None = None


@dataclass(frozen=True, config=STRICT)
class SceneSettings:
    """Keys that all `scenes` kinds have.

    depth_kind: whether the depth files hold z (along the optical axis) or slant range.
    bad_depth: what NaN, infinite and negative depths mean: a bad frame, or an unmeasured pixel.
    """

    depth_kind: Literal["z", "range"] = "z"
    bad_depth: Literal["reject", "mask"] = "reject"

    def own(self) -> tuple[OwnClass, ...]:
        """What the user's own objects are and how they echo."""
        return ()

    def own_classes(self) -> tuple[str, ...]:
        """Their classes, beside `labels.CLASSES` or among them."""
        return tuple(one.label for one in self.own())


@plain_dataclass(frozen=True)
class Discovery:
    """What a reader found.

    frames: every usable frame, sorted by (location, scene, frame).
    skipped: reason -> how many images were left out for it (for example no depth map).
    notes: one-line remarks for the user (which scenes are absent, which calibration was used).
    """

    frames: tuple[FrameRef, ...]
    skipped: dict[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


class Reader(Protocol):
    """Finds frames and loads them.  Built from settings alone, so a worker can build its own."""

    def discover(self) -> Discovery:
        """List the frames.

        Raises FactoryError when the root is missing, cannot be read, or holds nothing of use.
        """

    def load(self, ref: FrameRef) -> Frame:
        """Read one frame, checked (`frame.checked`).  Raises FrameError when it is bad."""


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Raise FactoryError that names what cannot be read at or below `path`."""
    try:
        yield
    except OSError as error:
        raise FactoryError(
            f"scenes.root: {error.filename or path} cannot be read ({error.strerror or error}); "
            "make it readable, or leave that recording out"
        ) from error


@plain_dataclass
class Found:
    """What a reader has found so far; see `Discovery`."""

    frames: list[FrameRef] = field(default_factory=list)
    skipped: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def discovery(self, nothing: str) -> Discovery:
        """All of it, sorted.  Without frames, raises FactoryError(nothing)."""
        if not self.frames:
            raise FactoryError(nothing)
        return Discovery(
            tuple(sorted(self.frames, key=lambda ref: (ref.location, ref.scene, ref.frame))),
            {reason: count for reason, count in sorted(self.skipped.items()) if count},
            tuple(self.notes),
        )


def root_folder(root: str, expected: str) -> Path:
    """The folder `root` (`~` expanded).  Raises FactoryError that tells which folder to give."""
    folder = Path(root).expanduser()
    with readable(folder):
        exists, is_folder = folder.exists(), folder.is_dir()
    if not is_folder:
        fault = "not a folder" if exists else "no such folder"
        raise FactoryError(f"scenes.root={root}: {fault}; set scenes.root to {expected}")
    return folder


def check_some_exist(frames: Sequence[FrameRef], given: str, remedy: str) -> None:
    """Raise FactoryError when none of the listed frames' pictures is there."""
    # Unlike Path.is_file, os.path.isfile raises nothing.
    if not any(os.path.isfile(path) for ref in frames for path in ref.paths[:2]):
        raise FactoryError(
            f"{given}: none of the {len(frames)} frames listed exists, the first is "
            f"{frames[0].paths[0]}; {remedy}"
        )


def visible_files(folder: Path) -> list[str]:
    """Names of the files of a folder, sorted; nothing when the folder is not there.

    Names that start with a dot are left out: archives made on a Mac carry a `._x.tiff` beside
    every `x.tiff`.  So are links that lead nowhere.  Raises OSError when it cannot be read.
    """
    if not folder.is_dir():
        return []
    with os.scandir(folder) as entries:
        return sorted(one.name for one in entries if one.name[0] != "." and one.is_file())


def numbered_lines(path: Path) -> list[tuple[int, str]]:
    """(line number, text) of the lines that are neither empty nor comments (`#`).

    Raises FactoryError when the file cannot be read, or is no text.
    """
    try:
        with readable(path):
            text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FactoryError(f"{path}: not a text file; give the recording's own list") from error
    numbered = enumerate((line.strip() for line in text.splitlines()), start=1)
    return [(number, line) for number, line in numbered if line and not line.startswith("#")]
