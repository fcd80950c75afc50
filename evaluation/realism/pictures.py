"""Pictures as they are measured: of folders, recordings and datasets, and as polar pictures.

Folders are the Marine Debris Dataset as it is, or pictures with geometry.csv, which has one line a
picture and these columns (docs/realism.md): file (`*` for all that have no line of their own),
layout, hfov_deg and, for fans, apex_x_px, apex_y_px, near_px, far_px; optional x_scale, range_min_m
and range_max_m.
"""

from __future__ import annotations

import csv
import dataclasses
import math
from collections.abc import Callable
from functools import lru_cache, partial
from pathlib import Path
from typing import Annotated, Any, Self

import cv2
import numpy as np
import numpy.typing as npt
import yaml
from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from ...factory.dataset.read.image_stack import ImageStack
from ...factory.dataset.read.reader import Split, open_shard, reading, shard_paths, value_range
from ...factory.errors import FactoryError
from ...factory.settings import STRICT, build
from ...factory.sonar.geometry import FanGeometry, recorded_sonar
from ...factory.sonar.settings import SonarSettings
from ...models.recordings import PICTURE_SUFFIXES, is_recording, kind_of, open_recording
from ...models.recordings.fan.finder import find_geometry
from ...models.recordings.fan.pings import frame_picture
from ...models.recordings.pictures import read_grey
from ..metrics.statistics import evenly
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


@dataclasses.dataclass(frozen=True)
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


@dataclasses.dataclass(frozen=True)
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
    table = root / GEOMETRY_FILE
    images = root / "Images" if (root / "Images").is_dir() else root
    files = sorted(path for path in images.iterdir() if path.is_file())
    paths = [path for path in files if kind_of(path) == "pictures"]
    if not paths and (
        recordings := [path for path in sorted(root.iterdir()) if is_recording(path)]
    ):
        return Collection(
            root.resolve().name, tuple(one for path in recordings for one in recorded(path))
        )
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


@dataclass(frozen=True, config=STRICT)
class _Polar:
    """A line of geometry.csv."""

    hfov_deg: Annotated[float, Field(gt=0, le=180)]
    range_min_m: Annotated[float, Field(ge=0)] | None = None
    range_max_m: float | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        ends = self.range_min_m, self.range_max_m
        if ends[0] is not None and ends[1] is not None and not ends[0] < ends[1]:
            raise ValueError("needs 0 <= range_min_m < range_max_m")
        return self


@dataclass(frozen=True, config=STRICT, kw_only=True)
class _Fan(_Polar):
    """A line of geometry.csv."""

    apex_x_px: float
    apex_y_px: float
    near_px: Annotated[float, Field(ge=0)]
    far_px: float
    x_scale: Annotated[float, Field(gt=0)] = 1.0

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if not self.near_px < self.far_px:
            raise ValueError("needs near_px < far_px")
        return self


def _with_table(table: Path, paths: list[Path]) -> tuple[Source, ...]:
    lines: dict[str, FanGeometry] = {}
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FactoryError(f"{table}: cannot be read ({error})") from error
    for number, row in enumerate(rows, start=2):
        known = {key: text.strip() for key, text in row.items() if key and text and text.strip()}
        where = f"{table}: line {number}"
        name, layout = known.pop("file", None), known.pop("layout", "")
        if name is None:
            raise FactoryError(f"{where}: no column 'file', or nothing in it")
        if layout not in ("fan", "polar"):
            raise FactoryError(f"{where}: layout must be fan or polar, got {layout!r}")
        values = {**vars(build(_Fan if layout == "fan" else _Polar, known, where))}
        sector_rad = math.radians(values.pop("hfov_deg"))
        lines[name] = getattr(FanGeometry, layout)(sector_rad, **values)
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
    paths = shard_paths(root, split)
    sonar = _sonar(root)
    sources: list[Source] = []
    narrow = 0
    for path in paths:
        with open_shard(path) as file:
            meta = file["meta"][:]
            full = np.float32(value_range(file))
        for row in range(len(meta)):
            geometry = FanGeometry.from_record(sonar, meta[row])
            first, last = geometry.data_fraction
            if last - first < _LEAST:
                narrow += 1
                continue
            name = f"{path.relative_to(root)}[{row}]"
            sources.append(Source(name, geometry, partial(_read, path, layer, row, full)))
    if not sources:
        raise FactoryError(
            f"sim={root}: the camera saw less than {_LEAST:.0%} of the sector in every picture; "
            "use a narrower sonar.hfov_deg"
        )
    notes = [
        f"{len(sources)} {layer} pictures of {root.name}, sonar {sonar.name}, "
        f"{sonar.hfov_deg:g} degrees, {sonar.image.layout}"
    ]
    if narrow:
        notes.append(f"{narrow} left out: the camera saw less than {_LEAST:.0%} of the sector")
    return Collection(root.resolve().name, tuple(sources), tuple(notes))


def _read(path: Path, layer: str, row: int, full: np.float32) -> Gray:
    with reading(path) as file:
        picture = ImageStack(file[layer])[row]
    return np.asarray(picture, np.float32) / full


def _sonar(root: Path) -> SonarSettings:
    try:
        sonar = recorded_sonar(yaml.safe_load((root / "config.yaml").read_text(encoding="utf-8")))
    except (OSError, yaml.YAMLError, UnicodeDecodeError):
        sonar = None
    if sonar is None:
        raise FactoryError(
            f"sim={root}: config.yaml does not say how its pictures are laid out; finish the "
            "dataset with the command that began it"
        )
    return sonar
