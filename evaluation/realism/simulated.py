"""The pictures of a dataset that the factory made, with their geometry."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import h5py
import numpy as np
import yaml

from simnfnd.evaluation.realism.geometry import Geometry, Gray
from simnfnd.evaluation.realism.pictures import Collection, Source, label_of
from simnfnd.factory.dataset.read.reader import Split, open_shard, shard_paths, value_range
from simnfnd.factory.errors import FactoryError

# Less of the sector than this says too little along the bearing.
_SEEN = 0.25


def open_dataset(folder: str | Path, split: Split, layer: str = "noisy") -> Collection:
    """The pictures of a dataset folder.  Raises FactoryError when there are none to compare."""
    root = Path(folder).expanduser()
    paths = shard_paths(root, split)
    sonar = _sonar(root)
    sources: list[Source] = []
    narrow = 0
    for path in paths:
        with open_shard(path) as file:
            shape = file[layer].shape[1:]
            meta = file["meta"][:]
            full = np.float32(value_range(file))
        for row in range(len(meta)):
            geometry = _geometry(sonar, meta[row], shape)
            if geometry.seen[1] - geometry.seen[0] < _SEEN:
                narrow += 1
                continue
            name = f"{path.relative_to(root)}[{row}]"
            sources.append(Source(name, geometry, partial(_read, path, layer, row, full)))
    if not sources:
        raise FactoryError(
            f"sim={root}: the camera saw less than {_SEEN:.0%} of the sector in every picture; "
            "use a narrower sonar.hfov_deg"
        )
    notes = [f"{len(sources)} {layer} pictures of {root.name}, {_words(sonar)}"]
    if narrow:
        notes.append(f"{narrow} left out: the camera saw less than {_SEEN:.0%} of the sector")
    return Collection(label_of(root), tuple(sources), tuple(notes))


def picture_geometry(
    layout: str,
    shape: tuple[int, int],
    hfov_deg: float,
    window_m: tuple[float, float],
    seen_deg: tuple[float, float],
) -> Geometry:
    """Where range and bearing are in a picture of the factory (`simnfnd.factory.sonar.fan`).

    shape: rows and columns.  window_m: first and last range.  seen_deg: the bearings with data.
    """
    near_m, far_m = window_m
    seen = (
        max(0.0, seen_deg[0] / hfov_deg + 0.5),
        min(1.0, seen_deg[1] / hfov_deg + 0.5),
    )
    if layout == "polar":
        return Geometry("polar", hfov_deg, range_min_m=near_m, range_max_m=far_m, seen=seen)
    rows, columns = shape
    half = np.deg2rad(hfov_deg) / 2
    fraction = near_m / far_m
    pixel = float(max(2 * np.sin(half) / columns, (1 - fraction * np.cos(half)) / rows))
    return Geometry(
        "fan",
        hfov_deg,
        apex_x_px=columns / 2 - 0.5,
        apex_y_px=1 / pixel - 0.5,
        near_px=fraction / pixel,
        far_px=1 / pixel,
        range_min_m=near_m,
        range_max_m=far_m,
        seen=seen,
    )


def _geometry(sonar: dict[str, object], row: np.void, shape: tuple[int, int]) -> Geometry:
    image = sonar["image"]
    assert isinstance(image, dict)
    return picture_geometry(
        str(image["layout"]),
        shape,
        float(str(sonar["hfov_deg"])),
        (float(row["range_min_m"]), float(row["range_max_m"])),
        (float(row["azimuth_min_deg"]), float(row["azimuth_max_deg"])),
    )


def _read(path: Path, layer: str, row: int, full: np.float32) -> Gray:
    with h5py.File(path, "r") as file:
        try:
            picture = file[layer][row]
        except OSError as error:
            raise FactoryError(f"{path}: sample {row} is damaged; generate it again") from error
    return np.asarray(picture, np.float32) / full


def _sonar(root: Path) -> dict[str, object]:
    path = root / "config.yaml"
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        sonar = content["sonar"]
        sonar["image"]["layout"], sonar["hfov_deg"]
    except (OSError, yaml.YAMLError, KeyError, TypeError) as error:
        raise FactoryError(
            f"sim={root}: {path.name} does not say how its pictures are laid out; finish the "
            "dataset with the command that began it"
        ) from error
    return dict(sonar)


def _words(sonar: dict[str, object]) -> str:
    image = sonar["image"]
    assert isinstance(image, dict)
    return f"sonar {sonar.get('name')}, {sonar['hfov_deg']:g} degrees, {image['layout']}"
