"""The pictures of a dataset that the factory made, with their geometry."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import yaml

from ...factory.dataset.read.image_stack import ImageStack
from ...factory.dataset.read.reader import (
    Split,
    open_shard,
    reading,
    shard_paths,
    value_range,
)
from ...factory.dataset.read.source import read_image
from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry, recorded_sonar
from ...factory.sonar.settings import SonarSettings
from .pictures import Collection, Source, label_of
from .polar import Gray

# Pictures with data in less of the sector than this say too little along the bearing.
_LEAST = 0.25


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
