"""Real pictures with what is measured on them: the sector, even zones, dark and bright ground."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.evaluation.baselines.base import Gray
from simnfnd.evaluation.data.image_pairs import images_in, read_gray
from simnfnd.evaluation.metrics.speckle import homogeneous_zones
from simnfnd.evaluation.realism.pictures import Source
from simnfnd.evaluation.realism.real import GEOMETRY_FILE, open_real
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.geometry import FanGeometry

Mask = npt.NDArray[np.bool_]

SIDE = 16  # of an even zone, pixels
_CALM = 15  # of the median that decides what is dark, pixels
_DARKEST, _BRIGHTER = 0.1, 0.5  # shares of the sector
_RING = 15  # around an object, pixels


@dataclass(frozen=True)
class File:
    """A picture of the folder.  geometry: of its fan or polar picture, None where it is unknown.

    mask: file of its class indices, None without.
    """

    source: Source | None
    path: Path
    mask: Path | None

    @property
    def name(self) -> str:
        """Of the file."""
        return self.path.name

    def read(self) -> Gray:
        """(H, W) float32 in 0..1.  FactoryError when it cannot be read."""
        return self.source.read() if self.source is not None else read_gray(self.path)

    def classes(self) -> npt.NDArray[np.uint8]:
        """(H, W) class index of each pixel, 0 = background.  FactoryError when unreadable."""
        assert self.mask is not None
        content = np.frombuffer(self.mask.read_bytes(), np.uint8)
        found = cv2.imdecode(content, cv2.IMREAD_UNCHANGED) if content.size else None
        if found is None or found.ndim != 2 or found.dtype != np.uint8:
            raise FactoryError(f"{self.mask}: no mask; a gray 8-bit picture of class indices is")
        if found.shape != self.read().shape:
            raise FactoryError(f"{self.mask}: another size than the picture that it belongs to")
        return np.asarray(found, dtype=np.uint8)


@dataclass(frozen=True)
class Scene:
    """What all methods share on a picture; all chosen on the picture as it is.

    sector, dark, bright: (H, W) bool.  zones: (N, 2) corners of even blocks.
    objects, around: (H, W) bool, of the mask; None without.
    """

    noisy: Gray
    sector: Mask
    dark: Mask
    bright: Mask
    zones: npt.NDArray[np.int64]
    objects: Mask | None
    around: Mask | None


def open_folder(folder: str, limit: int | None) -> tuple[list[File], tuple[str, ...]]:
    """The pictures of a folder (at most `limit`, evenly spread) and notes for the report.

    Raises FactoryError when there is none.
    """
    root = Path(folder).expanduser()
    if not root.is_dir():
        raise FactoryError(f"real={root}: no such folder; give one of real sonar pictures")
    images = root / "Images" if (root / "Images").is_dir() else root
    masks = root / "Masks"
    notes: tuple[str, ...] = ("no geometry is known: the sector is what is not black",)
    files: list[File] = []
    if images != root or (root / GEOMETRY_FILE).is_file():
        collection = open_real(root)
        notes = collection.notes
        files = [File(source, images / source.name, None) for source in collection.sources]
    else:
        files = [File(None, path, None) for path in images_in(root)]
    if not files:
        raise FactoryError(f"real={root}: holds no pictures")
    files = [
        File(file.source, file.path, masks / file.name if (masks / file.name).is_file() else None)
        for file in files
    ]
    if limit is not None and len(files) > limit:
        notes = (*notes, f"of these {len(files)} pictures {limit} are used, evenly spread")
        files = [files[number * len(files) // limit] for number in range(limit)]
    return files, notes


@lru_cache(maxsize=4)
def scene(file: File) -> Scene:
    """What is measured on a picture.  FactoryError when it is too small or black."""
    noisy = file.read()
    geometry = None if file.source is None else file.source.geometry
    sector = _sector(noisy, geometry)
    if min(noisy.shape) < SIDE or not sector.any():
        raise FactoryError(f"{file.path}: black, or smaller than {SIDE} pixels; take it out")
    calm = cv2.medianBlur(np.rint(np.clip(noisy, 0, 1) * 255).astype(np.uint8), _CALM)
    # Near the edge of the sector the median sees black that is no shadow.
    inner = cv2.erode(sector.astype(np.uint8), np.ones((_CALM, _CALM), np.uint8)).astype(bool)
    inner = inner if inner.any() else sector
    low, high = np.quantile(calm[inner], (_DARKEST, _BRIGHTER))
    objects = around = None
    if file.mask is not None:
        objects = file.classes() > 0
        wide = cv2.dilate(objects.astype(np.uint8), np.ones((2 * _RING + 1,) * 2, np.uint8))
        around = wide.astype(bool) & ~objects & sector
    return Scene(
        noisy,
        sector,
        inner & (calm <= low),
        inner & (calm > max(low, high)),
        homogeneous_zones(noisy, data_range=1.0, sector=sector, side=SIDE),
        objects,
        around,
    )


def geometry_of(file: File) -> FanGeometry | None:
    """Where range and bearing are in a picture; None where it is unknown."""
    if file.source is None:
        return None
    rows, columns = file.read().shape
    return file.source.geometry.with_size(rows, columns)


def _sector(noisy: Gray, geometry: FanGeometry | None) -> Mask:
    if geometry is not None:
        return geometry.sector_mask(noisy.shape[0], noisy.shape[1])
    # A dark picture has black pixels inside, too: its outline is what counts.
    lit = noisy > 0
    across = np.maximum.accumulate(lit, axis=1) & np.maximum.accumulate(lit[:, ::-1], 1)[:, ::-1]
    return np.asarray(across)
