"""Pictures as they are measured: of folders, recordings and datasets, and as polar pictures.

Folders are the Marine Debris Dataset as it is, or pictures with geometry.csv, which has one line a
picture and these columns (docs/realism.md): file (`*` for all that have no line of their own),
layout, hfov_deg and, for fans, apex_x_px, apex_y_px, near_px, far_px; optional x_scale, range_min_m
and range_max_m.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.dataset.read.reader import Split
from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ...models.recordings import PICTURE_SUFFIXES, is_recording, kind_of, open_recording
from ...models.recordings.fan.finder import find_geometry
from ...models.recordings.fan.pings import frame_picture
from ...models.recordings.pictures import read_grey
from ..metrics.statistics import evenly
from ..pairs import Place, geometry_of, items_of, picture
from ..settings import Grid

Gray = npt.NDArray[np.float32]

GEOMETRY_FILE = "geometry.csv"

MDD_SHAPE = (480, 320)
MDD_GEOMETRIES = {
    "A": FanGeometry.fan(
        math.radians(29.4), apex_x_px=159.3, apex_y_px=602.5, near_px=139.5, far_px=575.5
    ),
    "B": FanGeometry.fan(
        math.radians(29.6),
        apex_x_px=159.3,
        apex_y_px=748.5,
        near_px=291.5,
        far_px=718.5,
        x_scale=0.8,
    ),
}
"""The two fans that the pictures of the Marine Debris Dataset mix; metres are not published.

Measured on the edges of the sector in its pictures, and drawn in by the one or two pixels over
which they fade to black; B shows x squeezed to 0.8 of y.
"""
# The fit of a picture's black border to a fan: intersection over union below which it is none.
_SAME = 0.9
# Pictures with data in less of the sector than this say too little along the bearing.
_LEAST = 0.25


@dataclass(frozen=True)
class Source:
    """A picture that can be read when its turn comes.

    name: for messages.  read: gives (H, W) float32 grey values in 0..1; raises FactoryError.
    """

    name: str
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


def images_of(root: Path) -> Path:
    """Where the pictures of a folder lie: in its Images/, or in it."""
    return root / "Images" if (root / "Images").is_dir() else root


def has_geometry(root: Path) -> bool:
    """Whether a folder is one of pictures whose geometry is known."""
    return (root / "Images").is_dir() or (root / GEOMETRY_FILE).is_file()


def open_real(folder: str | Path) -> Collection:
    """The pictures of a folder in the order of their names, or the frames of recordings.

    folder: of pictures, or of recordings; or one recording.
    Raises FactoryError when there is none, or none that says where range and bearing are.
    """
    root = Path(folder).expanduser()
    if is_recording(root):
        return Collection(root.resolve().name, recorded(root))
    if not root.is_dir():
        raise FactoryError(
            f"real={root}: no such folder or recording; give one of real sonar pictures"
        )
    table, images = root / GEOMETRY_FILE, images_of(root)
    files = sorted(path for path in images.iterdir() if path.is_file())
    paths = [path for path in files if kind_of(path) == "pictures"]
    recordings = [path for path in sorted(root.iterdir()) if is_recording(path)]
    if recordings and not paths:
        frames = tuple(one for path in recordings for one in recorded(path))
        return Collection(root.resolve().name, frames)
    if not paths:
        raise FactoryError(
            f"real={root}: no pictures ({', '.join(PICTURE_SUFFIXES)}) there or in its Images/"
        )
    if table.is_file():
        return Collection(root.resolve().name, _with_table(table, paths))
    if images == root:
        raise FactoryError(
            f"real={root}: no {GEOMETRY_FILE}; write one (docs/realism.md says how), or give the "
            "folder of the Marine Debris Dataset that holds Images/"
        )
    return _mdd(root, paths)


def _mdd(root: Path, paths: list[Path]) -> Collection:
    sources, counts = [], dict.fromkeys(MDD_GEOMETRIES, 0)
    for path in paths:
        name = mdd_geometry(read_grey(path))
        if name is None:
            raise FactoryError(
                f"{path}: neither of the two fans of the Marine Debris Dataset (320x480, black "
                f"outside the sector); write {root / GEOMETRY_FILE} (docs/realism.md says how)"
            )
        counts[name] += 1
        sources.append(Source(path.name, MDD_GEOMETRIES[name], partial(read_grey, path)))
    mix = ", ".join(f"{count} of geometry {name}" for name, count in counts.items() if count)
    return Collection(root.resolve().name, tuple(sources), (f"Marine Debris Dataset: {mix}",))


def mdd_geometry(picture: npt.NDArray[np.floating]) -> str | None:
    """Which fan of the Marine Debris Dataset a picture shows, by its black border; None: neither.

    The original download does not say it, so it is looked up in each picture.
    """
    if picture.shape != MDD_SHAPE:
        return None
    across = outline(picture)
    agreement = {}
    for name, geometry in MDD_GEOMETRIES.items():
        sector = geometry.sector_mask(*MDD_SHAPE)
        agreement[name] = float((across & sector).sum() / max((across | sector).sum(), 1))
    best = max(agreement, key=lambda name: agreement[name])
    return best if agreement[best] >= _SAME else None


def outline(picture: npt.NDArray[np.floating]) -> npt.NDArray[np.bool_]:
    """(H, W) bool: what lies between the first and the last lit pixel of each row.

    A dark picture has black pixels inside, too: its outline is what counts.
    """
    lit = picture > 0
    left, right = np.maximum.accumulate(lit, 1), np.maximum.accumulate(lit[:, ::-1], 1)[:, ::-1]
    return np.asarray(left & right)


def _with_table(table: Path, paths: list[Path]) -> tuple[Source, ...]:
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FactoryError(f"{table}: cannot be read ({error})") from error
    lines = dict(_line(row, f"{table}: line {number}") for number, row in enumerate(rows, start=2))
    absent = sorted(set(lines) - {"*"} - {path.name for path in paths})
    if absent:
        raise FactoryError(f"{table}: {absent[0]} is listed but there is no such picture")
    sources = []
    for path in paths:
        geometry = lines.get(path.name, lines.get("*"))
        if geometry is None:
            raise FactoryError(f"{table}: no line for {path.name}; add one, or one for all: *")
        sources.append(Source(path.name, geometry, partial(read_grey, path)))
    return tuple(sources)


def _line(row: Mapping[str, str | None], where: str) -> tuple[str, FanGeometry]:
    """The picture's name and geometry in a line of geometry.csv.  Raises FactoryError."""
    known = {key: text.strip() for key, text in row.items() if key and text and text.strip()}
    name, layout = known.pop("file", None), known.pop("layout", "")
    if name is None:
        raise FactoryError(f"{where}: no column 'file', or nothing in it")
    if layout not in ("fan", "polar"):
        raise FactoryError(f"{where}: layout must be fan or polar, got {layout!r}")
    try:
        values = {key: float(text) for key, text in known.items()}
        for low, high in (("range_min_m", "range_max_m"), ("near_px", "far_px")):
            if not 0 <= values.get(low, 0) < values.get(high, math.inf):
                raise ValueError(f"needs 0 <= {low} < {high}")
        if not 0 < (sector_deg := values.pop("hfov_deg")) <= 180 or values.get("x_scale", 1) <= 0:
            raise ValueError("needs 0 < hfov_deg <= 180 and x_scale > 0")
        geometry: FanGeometry = getattr(FanGeometry, layout)(math.radians(sector_deg), **values)
    except (ValueError, TypeError, KeyError) as error:
        raise FactoryError(f"{where}: {error}; docs/realism.md has the columns") from error
    return name, geometry


def recorded(path: Path) -> tuple[Source, ...]:
    """All frames of a recording; the fan of a video is found in its first frame.

    Raises FactoryError when it cannot be read, or nothing tells where range and bearing are.
    """
    sources: list[Source] = []
    found: FanGeometry | None = None
    with open_recording(path) as recording:
        count = len(recording)
    for number in range(count):
        picture, geometry = frame_picture(path, number)
        if geometry is None and found is None:
            found = find_geometry(picture)
        geometry = geometry or found
        if geometry is None:
            raise FactoryError(
                f"real={path}: no fan is seen in its pictures; save its frames as pictures beside "
                "a geometry.csv (docs/realism.md says how)"
            )
        name = f"{path.name}#{number}"
        sources.append(Source(name, geometry, partial(_frame, path, number)))
    return tuple(sources)


def _frame(path: Path, number: int) -> Gray:
    return frame_picture(path, number)[0]


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
            name = f"{item.shard}[{item.place[1]}]"
            sources.append(Source(name, geometry, partial(_layer, item.place, layer)))
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
