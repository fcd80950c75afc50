"""Pictures as `realism` and `fit` compare them: real ones and those of datasets, made polar."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.dataset.reader import Split
from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ..metrics.statistics import evenly
from ..pairs import Place, geometry_of, items_of, picture
from ..recorded import Gray, Shot, open_real
from ..settings import Grid

# Pictures with data in less of the sector than this say too little along the bearing.
_LEAST = 0.25


@dataclass(frozen=True)
class Source:
    """A picture that can be read when its turn comes.

    read: gives (H, W) float32 grey values in 0..1; raises FactoryError.
    """

    geometry: FanGeometry
    read: Callable[[], Gray]

    def polar(self, grid: Grid) -> Gray:
        """(range_bins, beams) float32 in 0..1."""
        return to_polar(self.read(), self.geometry, grid)


@dataclass(frozen=True)
class Collection:
    """Pictures that belong together.  name: what tables call them.  notes: for the report."""

    name: str
    sources: tuple[Source, ...]
    notes: tuple[str, ...] = ()

    def at_most(self, limit: int | None) -> Collection:
        """Evenly spread ones, when there are more than `limit`."""
        return Collection(self.name, tuple(evenly(self.sources, limit)), self.notes)


def to_polar(picture: npt.NDArray[Any], geometry: FanGeometry, grid: Grid) -> Gray:
    """(H, W) grey values -> (range_bins, beams with data) float32, near range and left first.

    Inverse mapping: each cell of the grid looks up its place in the picture, bilinear.  Only whole
    cells within `geometry.data_fraction` are kept.
    """
    columns, rows = _lookup(geometry, grid, picture.shape[:2])
    gray = np.ascontiguousarray(picture, dtype=np.float32)
    return np.asarray(
        cv2.remap(gray, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE),
        dtype=np.float32,
    )


@lru_cache(maxsize=16)
def _lookup(geometry: FanGeometry, grid: Grid, shape: tuple[int, int]) -> tuple[Gray, Gray]:
    """Column and row in the picture of each cell of the grid."""
    start, end = geometry.data_fraction
    first = math.ceil(round(start * grid.beams, 6))
    last = max(math.floor(round(end * grid.beams, 6)), first + 1)
    along = (np.arange(grid.range_bins) + 0.5)[:, None] / grid.range_bins
    across = (np.arange(first, last) + 0.5)[None, :] / grid.beams
    range_fraction = geometry.near_fraction + along * (1 - geometry.near_fraction)
    azimuth_rad = (across - 0.5) * geometry.sector_rad
    rows, columns = np.broadcast_arrays(
        *geometry.with_size(*shape).pixels(range_fraction, azimuth_rad)
    )
    return np.ascontiguousarray(columns, np.float32), np.ascontiguousarray(rows, np.float32)


def real_pictures(folder: str | Path) -> Collection:
    """See `open_real`."""
    shots, notes = open_real(folder)
    sources = [Source(one.known, partial(_of_shot, one)) for one in shots if one.known]
    return Collection(Path(folder).expanduser().resolve().name, tuple(sources), notes)


def _of_shot(shot: Shot) -> Gray:
    return shot.read()[0]


def open_dataset(folder: str | Path, split: Split, layer: str = "noisy") -> Collection:
    """The pictures of a dataset folder.  Raises FactoryError when there are none to compare."""
    root = Path(folder).expanduser()
    sources: list[Source] = []
    items = items_of(root, split)
    for item in items:
        geometry = geometry_of(item.place)
        if geometry is None:
            raise FactoryError(
                f"sim={root}: {item.shard} does not say how its pictures are laid out"
            )
        first, last = geometry.data_fraction
        if last - first >= _LEAST:
            sources.append(Source(geometry, partial(_layer, item.place, layer)))
    narrow = f"the camera saw less than {_LEAST:.0%} of the sector"
    if not sources:
        raise FactoryError(f"sim={root}: {narrow} in every picture; use a narrower sonar.hfov_deg")
    notes = [f"{len(sources)} {layer} pictures of {root.name}, {sources[0].geometry.layout}"]
    if left := len(items) - len(sources):
        notes.append(f"{left} left out: {narrow}")
    return Collection(root.resolve().name, tuple(sources), tuple(notes))


def _layer(place: Place, layer: str) -> Gray:
    pair = picture(place)
    return pair.noisy if layer == "noisy" else pair.clean
