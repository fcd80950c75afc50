"""What there is to judge by: pictures of a folder, frames of recordings, with their geometry."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ...models.recordings import kind_of, open_recording
from ...models.recordings.fan.pings import frame_picture
from ..filters.base import Gray
from ..realism.pictures import GEOMETRY_FILE, open_real, outline

Mask = npt.NDArray[np.bool_]

IMAGES, MASKS = "Images", "Masks"


@dataclass(frozen=True)
class Shot:
    """A picture or a frame, read when its turn comes.

    path, number: of the picture or recording, and of the frame in it.
    told: where range and bearing are, as a table says; None where it must be found or known from
    the file.  mask: file of class indices, None without.
    """

    path: Path
    number: int
    name: str
    told: FanGeometry | None = None
    mask: Path | None = None

    def read(self) -> tuple[Gray, FanGeometry | None]:
        """(H, W) float32 in 0..1, a ping as a fan; and the geometry, None where nothing says it.

        Raises FactoryError when it cannot be read.
        """
        picture, geometry = frame_picture(self.path, self.number)
        if geometry is not None:
            return picture, geometry
        return picture, None if self.told is None else self.told.with_size(*picture.shape)

    def classes(self) -> npt.NDArray[np.uint8]:
        """(H, W) class index of each pixel, 0 = background.  FactoryError when unreadable."""
        assert self.mask is not None
        content = np.frombuffer(self.mask.read_bytes(), np.uint8)
        found = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
        if found is None or found.ndim != 2 or found.dtype != np.uint8:
            raise FactoryError(f"{self.mask}: no mask; a gray 8-bit picture of class indices is")
        if found.shape != self.read()[0].shape:
            raise FactoryError(f"{self.mask}: another size than the picture that it belongs to")
        return np.asarray(found, dtype=np.uint8)


@dataclass(frozen=True)
class Stretch:
    """Shots in which one scene may stay: those of a folder or of a recording, in order."""

    name: str
    shots: tuple[Shot, ...]


def open_input(given: str, search: int) -> tuple[list[Stretch], tuple[str, ...]]:
    """All folders and recordings at a path, with notes for the report.

    search: of each stretch at most so many shots, the first ones.
    Raises FactoryError when there is nothing, or a recording cannot be opened.
    """
    root = Path(given).expanduser()
    if not root.exists():
        raise FactoryError(f"real={root}: no such folder or recording")
    notes: tuple[str, ...] = ()
    if root.is_dir() and ((root / IMAGES).is_dir() or (root / GEOMETRY_FILE).is_file()):
        collection = open_real(root)
        images = root / IMAGES if (root / IMAGES).is_dir() else root
        notes = collection.notes
        shots = [
            _picture(images / source.name, root / MASKS, source.geometry)
            for source in collection.sources
        ]
        found = [Stretch(collection.name, tuple(shots))]
    else:
        found = _below(root)
    if not found:
        raise FactoryError(f"real={root}: holds no pictures and no recordings")
    for stretch in found:
        if len(stretch.shots) > search:
            count = len(stretch.shots)
            notes += (f"of the {count} frames of {stretch.name} the first {search} are looked at",)
    return [Stretch(one.name, one.shots[:search]) for one in found], notes


def sector_of(picture: Gray, geometry: FanGeometry | None) -> Mask:
    """(H, W) bool: the sector; where no geometry is known what lies within the lit outline."""
    if geometry is not None:
        return geometry.sector_mask(*picture.shape)
    return outline(picture)


def _below(root: Path) -> list[Stretch]:
    if root.is_file():
        return [_recording(root, root.name)]
    found = []
    folders = [root, *(path for path in sorted(root.rglob("*")) if path.is_dir())]
    for folder in folders:
        parts = folder.relative_to(root).parts
        if any(part.startswith(".") or part == MASKS for part in parts):
            continue
        name = "/".join(parts) or root.resolve().name
        files = sorted(path for path in folder.iterdir() if path.is_file())
        kinds = {path: kind_of(path) for path in files}
        pictures = [path for path, kind in kinds.items() if kind == "pictures"]
        if pictures:
            shots = tuple(_picture(path, folder / MASKS, None) for path in pictures)
            found.append(Stretch(name, shots))
        for path, kind in kinds.items():
            if kind not in (None, "pictures"):
                found.append(_recording(path, path.relative_to(root).as_posix()))
    return found


def _picture(path: Path, masks: Path, told: FanGeometry | None) -> Shot:
    mask = masks / path.name
    return Shot(path, 0, path.name, told, mask if mask.is_file() else None)


def _recording(path: Path, name: str) -> Stretch:
    with open_recording(path) as recording:
        count = len(recording)
    if kind_of(path) == "pictures":
        return Stretch(name, (Shot(path, 0, path.name),))
    return Stretch(name, tuple(Shot(path, n, f"{path.name}#{n}") for n in range(count)))
