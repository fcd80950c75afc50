"""What there is to judge by: pictures of a folder, frames of recordings, with their geometry."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ...models.recordings import kind_of, open_recording
from ...models.recordings.fan.pings import frame_picture
from ..filters.base import Gray
from ..realism.pictures import has_geometry, images_of, open_real, outline

Mask = npt.NDArray[np.bool_]

MOST = 600
"""Frames of a folder or recording that are looked at, the first ones."""


@dataclass(frozen=True)
class Shot:
    """A picture or a frame, read when its turn comes.

    path, number: of the picture or recording, and of the frame in it.
    told: where range and bearing are, as a table says; None where it must be found or known from
    the file.
    """

    path: Path
    number: int
    name: str
    told: FanGeometry | None = None

    def read(self) -> tuple[Gray, FanGeometry | None]:
        """(H, W) float32 in 0..1, a ping as a fan; and the geometry, None where nothing says it.

        Raises FactoryError when it cannot be read.
        """
        picture, geometry = frame_of(self.path, self.number)
        if geometry is not None:
            return picture, geometry
        return picture, None if self.told is None else self.told.with_size(*picture.shape)


@lru_cache(maxsize=160)
def frame_of(path: Path, number: int) -> tuple[Gray, FanGeometry | None]:
    """See `frame_picture`; frames are asked for again and again, and cost more to decode."""
    return frame_picture(path, number)


@dataclass(frozen=True)
class Stretch:
    """Shots in which one scene may stay: those of a folder or of a recording, in order."""

    name: str
    shots: tuple[Shot, ...]


def open_input(given: str) -> tuple[list[Stretch], tuple[str, ...]]:
    """All folders and recordings at a path, with notes for the report.

    Raises FactoryError when there is nothing, or a recording cannot be opened.
    """
    root = Path(given).expanduser()
    if not root.exists():
        raise FactoryError(f"real={root}: no such folder or recording")
    notes: tuple[str, ...] = ()
    if has_geometry(root):
        collection, images = open_real(root), images_of(root)
        notes = collection.notes
        every = [Shot(images / one.name, 0, one.name, one.geometry) for one in collection.sources]
        found = [Stretch(collection.name, tuple(every))]
    else:
        found = _below(root)
    if not found:
        raise FactoryError(f"real={root}: holds no pictures and no recordings")
    for stretch in found:
        if (count := len(stretch.shots)) > MOST:
            notes += (f"of the {count} frames of {stretch.name} the first {MOST} are looked at",)
    return [Stretch(one.name, one.shots[:MOST]) for one in found], notes


def sector_of(picture: Gray, geometry: FanGeometry | None) -> Mask:
    """(H, W) bool: the sector; where no geometry is known what lies within the lit outline."""
    return outline(picture) if geometry is None else _sector(geometry, picture.shape)


@lru_cache(maxsize=4)
def _sector(geometry: FanGeometry, shape: tuple[int, int]) -> Mask:
    """The frames of a recording have one sector."""
    return geometry.sector_mask(*shape)


def _below(root: Path) -> list[Stretch]:
    if root.is_file():
        return [_recording(root, root.name)]
    found = []
    folders = [root, *(path for path in sorted(root.rglob("*")) if path.is_dir())]
    for folder in folders:
        parts = folder.relative_to(root).parts
        if any(part.startswith(".") or part == "Masks" for part in parts):
            continue
        files = sorted(path for path in folder.iterdir() if path.is_file())
        kinds = {path: kind_of(path) for path in files}
        shots = tuple(Shot(one, 0, one.name) for one, kind in kinds.items() if kind == "pictures")
        if shots:
            found.append(Stretch("/".join(parts) or root.resolve().name, shots))
        for path, kind in kinds.items():
            if kind not in (None, "pictures"):
                found.append(_recording(path, path.relative_to(root).as_posix()))
    return found


def _recording(path: Path, name: str) -> Stretch:
    with open_recording(path) as recording:
        count = len(recording)
    if kind_of(path) == "pictures":
        return Stretch(name, (Shot(path, 0, path.name),))
    return Stretch(name, tuple(Shot(path, n, f"{path.name}#{n}") for n in range(count)))
