"""Pictures as they are measured: of folders, recordings and datasets of the factory."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import yaml

from ...factory.dataset.read.image_stack import ImageStack
from ...factory.dataset.read.reader import Split, open_shard, reading, shard_paths, value_range
from ...factory.dataset.read.source import read_image
from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry, recorded_sonar
from ...factory.sonar.settings import SonarSettings
from ...models.recordings import open_recording
from ...models.recordings.fan.finder import find_geometry
from ...models.recordings.fan.pings import frame_picture
from .polar import Gray, Grid, to_polar

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
        if limit is None or len(self.sources) <= limit:
            return self
        chosen = tuple(self.sources[number * len(self.sources) // limit] for number in range(limit))
        return Collection(self.name, chosen, self.notes)


def label_of(folder: Path) -> str:
    """The last part of a path, without what paths cannot do without."""
    return folder.resolve().name


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
        sources.append(Source(f"{path.name}#{number}", geometry, partial(_picture, path, number)))
    return tuple(sources)


def _picture(path: Path, number: int) -> Gray:
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
    notes = [f"{len(sources)} {layer} pictures of {root.name}, {_described(sonar)}"]
    if narrow:
        notes.append(f"{narrow} left out: the camera saw less than {_LEAST:.0%} of the sector")
    return Collection(label_of(root), tuple(sources), tuple(notes))


def _read(path: Path, layer: str, row: int, full: np.float32) -> Gray:
    with reading(path) as file:
        picture = read_image(ImageStack(file[layer]), layer, row)
    return np.asarray(picture, np.float32) / full


def _sonar(root: Path) -> SonarSettings:
    path = root / "config.yaml"
    try:
        sonar = recorded_sonar(yaml.safe_load(path.read_text(encoding="utf-8")))
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise FactoryError(_unknown_layout(root)) from error
    if sonar is None:
        raise FactoryError(_unknown_layout(root))
    return sonar


def _unknown_layout(root: Path) -> str:
    return (
        f"sim={root}: config.yaml does not say how its pictures are laid out; finish the dataset "
        "with the command that began it"
    )


def _described(sonar: SonarSettings) -> str:
    return f"sonar {sonar.name}, {sonar.hfov_deg:g} degrees, {sonar.image.layout}"
