"""Folders of real pictures: the Marine Debris Dataset as it is, or pictures with geometry.csv.

geometry.csv has one line a picture and these columns (docs/realism.md): file (`*` for all that have
no line of their own), layout, hfov_deg and, for fans, apex_x_px, apex_y_px, near_px, far_px;
optional x_scale, range_min_m and range_max_m.
"""

from __future__ import annotations

import csv
import math
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ...models.recordings import PICTURE_SUFFIXES, is_recording, kind_of
from ...models.recordings.pictures import read_grey
from .sources import Collection, Source, label_of, recorded

GEOMETRY_FILE = "geometry.csv"
_FAN = ("apex_x_px", "apex_y_px", "near_px", "far_px")
_METRES = ("range_min_m", "range_max_m")
_COLUMNS = ("layout", "hfov_deg", *_FAN, "x_scale", *_METRES)

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


def open_real(folder: str | Path) -> Collection:
    """The pictures of a folder in the order of their names, or the frames of recordings.

    folder: of pictures, or of recordings; or one recording.
    Raises FactoryError when there is none, or none that says where range and bearing are.
    """
    root = Path(folder).expanduser()
    if is_recording(root):
        return Collection(label_of(root), recorded(root))
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
            label_of(root), tuple(one for path in recordings for one in recorded(path))
        )
    if not paths:
        raise FactoryError(
            f"real={root}: no pictures ({', '.join(PICTURE_SUFFIXES)}) there or in its Images/"
        )
    if table.is_file():
        return Collection(label_of(root), _with_table(table, paths))
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
    return Collection(label_of(root), tuple(sources), (f"Marine Debris Dataset: {mix}",))


def mdd_geometry(picture: npt.NDArray[np.floating]) -> str | None:
    """Which fan of the Marine Debris Dataset a picture shows, by its black border; None: neither.

    The original download does not say it, so it is looked up in each picture.
    """
    if picture.shape != MDD_SHAPE:
        return None
    # A dark picture has black pixels inside as well: its outline is what counts.
    lit = picture > 0
    across = np.maximum.accumulate(lit, axis=1) & np.maximum.accumulate(lit[:, ::-1], 1)[:, ::-1]
    agreement = {}
    for name, geometry in MDD_GEOMETRIES.items():
        sector = geometry.sector_mask(*MDD_SHAPE)
        agreement[name] = float((across & sector).sum() / max((across | sector).sum(), 1))
    best = max(agreement, key=lambda name: agreement[name])
    return best if agreement[best] >= _SAME else None


def _with_table(table: Path, paths: list[Path]) -> tuple[Source, ...]:
    lines: dict[str, FanGeometry] = {}
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            unknown = set(reader.fieldnames or ()) - {"file", *_COLUMNS}
            if unknown or "file" not in (reader.fieldnames or ()):
                what = f"unknown column {sorted(unknown)[0]!r}" if unknown else "no column 'file'"
                raise FactoryError(f"{table}: {what}; columns are file, {', '.join(_COLUMNS)}")
            for row in reader:
                lines[row["file"]] = _geometry(row, f"{table}: line {reader.line_num}")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise FactoryError(f"{table}: cannot be read ({error})") from error
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


def _geometry(row: dict[str, str], where: str) -> FanGeometry:
    values: dict[str, float] = {}
    for name in _COLUMNS:
        text = (row.get(name) or "").strip()
        if name == "layout" or not text:
            continue
        try:
            values[name] = float(text)
        except ValueError as error:
            raise FactoryError(f"{where}: {name} is no number: {text!r}") from error
        if not math.isfinite(values[name]):
            raise FactoryError(f"{where}: {name} must be finite, got {text}")
    layout = (row.get("layout") or "").strip()
    if layout not in ("fan", "polar"):
        raise FactoryError(f"{where}: layout must be fan or polar, got {layout!r}")
    needed = ("hfov_deg", *(_FAN if layout == "fan" else ()))
    missing = [name for name in needed if name not in values]
    if missing:
        raise FactoryError(f"{where}: {missing[0]} is missing; a {layout} needs {list(needed)}")
    hfov_deg = values["hfov_deg"]
    if not 0 < hfov_deg <= 180:
        raise FactoryError(f"{where}: hfov_deg must lie in (0, 180], got {hfov_deg:g}")
    metres = {name: values[name] for name in _METRES if name in values}
    if len(metres) == 2 and not 0 <= metres["range_min_m"] < metres["range_max_m"]:
        raise FactoryError(f"{where}: needs 0 <= range_min_m < range_max_m")
    sector_rad = math.radians(hfov_deg)
    if layout == "polar":
        return FanGeometry.polar(sector_rad, **metres)
    x_scale = values.get("x_scale", 1.0)
    if not (0 <= values["near_px"] < values["far_px"] and x_scale > 0):
        raise FactoryError(f"{where}: needs 0 <= near_px < far_px and x_scale > 0")
    fan = {name: values[name] for name in _FAN}
    return FanGeometry.fan(sector_rad, **fan, x_scale=x_scale, **metres)
