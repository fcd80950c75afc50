"""Images and frames of real sonars, read when their turn comes, with their geometry.

A folder of images may state their geometry in geometry.csv, which has one line an image and these
columns (docs/realism.md): file (`*` for all that have no line of their own), layout, hfov_deg and,
for fans, apex_x_px, apex_y_px, near_px, far_px; optional x_scale, range_min_m and range_max_m.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...factory.common.array_types import Bools, Floats
from ...factory.common.errors import FactoryError
from ...factory.common.files import real_path
from ...factory.dataset import PairDataset
from ...factory.dataset.fan_geometry import FanGeometry
from ...models.recordings import DATASET, dataset_of, kind_of, open_recording
from ...models.recordings.device_settings import RecordedSettings
from ...models.recordings.fan_tracking import FanTracker
from ...models.recordings.names import in_order
from ...models.recordings.views import frame_image, frame_settings
from ..metrics.measure import Grey

GEOMETRY_FILE = "geometry.csv"


@dataclass(frozen=True)
class RecordedImage:
    """An image, or a frame of a recording.

    path, number: of the image or recording, and of the frame in it.
    known: where range and bearing are, as a table says; None where it must be found or stands in
    the file.
    """

    path: Path
    number: int
    name: str
    known: FanGeometry | None = None

    def read(self) -> tuple[Grey, FanGeometry | None]:
        """(H, W) float32 in 0..1, a ping as a fan; and the geometry, None where nothing says it.

        Raises FactoryError when it cannot be read.
        """
        image, geometry = frame_of(self.path, self.number)
        if geometry is not None:
            return image, geometry
        return image, None if self.known is None else self.known.with_size(*image.shape)

    def names(self) -> list[str]:
        """Where another program's image of it may lie in a folder, without a suffix."""
        if kind_of(self.path) == "images":
            return [f"{self.path.parent.name}/{self.path.stem}", self.path.stem]
        return [f"{self.path.stem}/{self.number:06d}", f"{self.number:06d}"]

    def settings(self) -> RecordedSettings:
        """Of the sonar, as the recording or the name states them.  Raises FactoryError."""
        return frame_settings(self.path, self.number)


@lru_cache(maxsize=160)
def frame_of(path: Path, number: int) -> tuple[Grey, FanGeometry | None]:
    """The image and geometry of a frame, as `frame_image` gives them, kept for further calls.

    Every method reads each frame again, and decoding costs more than keeping.
    """
    return frame_image(path, number)


@dataclass(frozen=True)
class Stretch:
    """Shots in which one scene may stay: those of a folder or of a recording, in order."""

    name: str
    shots: tuple[RecordedImage, ...]


def open_input(
    location: str | Path, most: int | None = None, key: str = "real"
) -> tuple[list[Stretch], tuple[str, ...]]:
    """All folders and recordings at a path, or of a dataset, and notes for the report.

    most: number of shots of each, the first ones.  key: of the configuration, for errors.
    Raises FactoryError when there is nothing, or a recording cannot be opened.
    """
    root = Path(location).expanduser()
    notes: tuple[str, ...] = ()
    if dataset_of(root) == root:
        names = PairDataset(root, "all", trusted=True).recordings.names
        stretches = [_recording(root / name, name) for name in names]
    elif kind_of(root) == DATASET:
        stretches = [_recording(root, root.name)]
    elif not root.exists():
        raise FactoryError(f"{key}={root}: no such folder or recording")
    elif (root / GEOMETRY_FILE).is_file():
        stretches = [Stretch(real_path(root).name, _with_table(root / GEOMETRY_FILE))]
    else:
        stretches = _below(root)
    if not stretches:
        raise FactoryError(f"{key}={root}: holds no images and no recordings")
    for stretch in stretches:
        if most is not None and (count := len(stretch.shots)) > most:
            notes += (f"of the {count} frames of {stretch.name} the first {most} are used",)
    return [Stretch(stretch.name, stretch.shots[:most]) for stretch in stretches], notes


def open_real(location: str | Path) -> tuple[list[RecordedImage], tuple[str, ...]]:
    """All shots at a path, each with its geometry: stated, or found in the image; and notes.

    Raises FactoryError as `open_input` does, and for an image in which no fan is found.
    """
    stretches, notes = open_input(location)
    shots_with_fans: list[RecordedImage] = []
    trackers: dict[Path, FanTracker] = {}
    for shot in (shot for stretch in stretches for shot in stretch.shots):
        known = shot.known
        if known is None:
            image, known = shot.read()
            known = known or trackers.setdefault(shot.path, FanTracker()).geometry(image)
        if known is None:
            raise FactoryError(
                f"real={shot.path}: no fan is seen in it; write a {GEOMETRY_FILE} beside images "
                "(docs/realism.md says how)"
            )
        shots_with_fans.append(replace(shot, known=known))
    return shots_with_fans, notes


def outline(image: Floats) -> Bools:
    """(H, W) bool: what lies between the first and the last lit pixel of each row.

    A dark image has black pixels inside, too: its outline is what counts.
    """
    lit = image > 0
    left = np.maximum.accumulate(lit, 1)
    right = np.maximum.accumulate(lit[:, ::-1], 1)[:, ::-1]
    return np.asarray(left & right)


def _with_table(table: Path) -> tuple[RecordedImage, ...]:
    """The images beside a table with the fans that it gives them, one line each or for all (`*`).

    Raises FactoryError for a damaged table, and for images or lines without the other.
    """
    files = sorted(path for path in table.parent.iterdir() if path.is_file())
    paths = in_order([path for path in files if kind_of(path) == "images"])
    lines = dict[str, FanGeometry]()
    number = 1
    try:
        with table.open(newline="", encoding="utf-8-sig") as file:
            for row in csv.DictReader(file):
                number += 1
                name, geometry = _line(row)
                lines[name] = geometry
    except (OSError, csv.Error, ValueError, TypeError, KeyError) as error:
        raise FactoryError(
            f"{table}: line {number}: {error}; docs/realism.md has the columns"
        ) from error
    if absent := sorted(set(lines) - {"*"} - {path.name for path in paths}):
        raise FactoryError(f"{table}: {absent[0]} is listed but there is no such image")
    if "*" not in lines and (more := [path.name for path in paths if path.name not in lines]):
        raise FactoryError(f"{table}: no line for {more[0]}; add one, or one for all: *")
    return tuple(
        RecordedImage(path, 0, path.name, lines.get(path.name) or lines["*"]) for path in paths
    )


def _line(row: Mapping[str, str | None]) -> tuple[str, FanGeometry]:
    """The image's name and geometry in a line of geometry.csv; ValueError says what is wrong."""
    known = {key: text.strip() for key, text in row.items() if key and text and text.strip()}
    name = known.pop("file", None)
    layout = known.pop("layout", "")
    if name is None or layout not in ("fan", "polar"):
        raise ValueError("no column 'file', or layout is neither fan nor polar")
    values = {key: float(text) for key, text in known.items()}
    for low, high in (("range_min_m", "range_max_m"), ("near_px", "far_px")):
        if not 0 <= values.get(low, 0) < values.get(high, math.inf):
            raise ValueError(f"needs 0 <= {low} < {high}")
    if not 0 < (sector_deg := values.pop("hfov_deg")) <= 180 or values.get("x_scale", 1) <= 0:
        raise ValueError("needs 0 < hfov_deg <= 180 and x_scale > 0")
    return name, getattr(FanGeometry, layout)(math.radians(sector_deg), **values)


def _below(root: Path) -> list[Stretch]:
    """A stretch for each folder of images and for each recording below a path."""
    if root.is_file():
        return [_recording(root, root.name)]
    stretches = []
    folders = [root, *(path for path in sorted(root.rglob("*")) if path.is_dir())]
    for folder in folders:
        parts = folder.relative_to(root).parts
        if any(part.startswith(".") or part == "Masks" for part in parts):
            continue
        files = sorted(path for path in folder.iterdir() if path.is_file())
        kinds = {path: kind_of(path) for path in files}
        images = in_order([path for path, kind in kinds.items() if kind == "images"])
        shots = tuple(RecordedImage(path, 0, path.name) for path in images)
        if shots:
            stretches.append(Stretch("/".join(parts) or real_path(root).name, shots))
        for path, kind in kinds.items():
            if kind not in (None, "images"):
                stretches.append(_recording(path, path.relative_to(root).as_posix()))
    return stretches


def _recording(path: Path, name: str) -> Stretch:
    with open_recording(path) as recording:
        count = len(recording)
    if kind_of(path) == "images":
        return Stretch(name, (RecordedImage(path, 0, path.name),))
    return Stretch(name, tuple(RecordedImage(path, n, f"{path.name}#{n}") for n in range(count)))
