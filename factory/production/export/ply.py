"""Point clouds: one PLY file a pair, its echoes in space with class and intensity, by Open3D."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...common.array_types import Float32s
from ...common.errors import FactoryError
from ...dataset.pair_dataset import PairDataset, in_unit_range
from .notes import describe_labels, write_notes
from .samples import ExportedSample, read_samples

_NEEDED = ("range", "azimuth", "elevation")


def write_ply(pairs: PairDataset, folder: Path) -> str:
    """SPLIT/NNNNNN.ply: the strongest echo of each pixel that has one, in the sonar's axes.

    Properties: x (ahead), y (left), z (up), m; intensity (noisy) and clean, 0..1; class and
    instance where the dataset is labelled.
    Raises FactoryError for a dataset without the layers range, azimuth and elevation.
    """
    missing = [name for name in _NEEDED if name not in pairs.layers]
    if missing:
        raise FactoryError(
            f"{pairs.folder} has no layer {', '.join(missing)}; make it with "
            "dataset.layers=[range,azimuth,elevation,segmentation]"
        )
    points = 0
    for split in pairs.splits:
        (folder / split).mkdir()
        for sample in read_samples(pairs, split):
            points += write_points(folder / split / f"{sample.number}.ply", sample)
    labels = describe_labels(pairs)
    notes = f"{_NOTES}\nValues of `class`: {labels}\n" if labels else _NOTES
    write_notes(pairs, folder, notes, layers=(), has_records=False)
    return f"{len(pairs)} point clouds, {points} points"


def write_points(path: Path, sample: ExportedSample) -> int:
    """Write the cloud of one sample; returns the number of its points."""
    from open3d import core, t

    images = sample.images
    is_echo = np.isfinite(images["range"])
    positions = positions_of(*(images[name][is_echo] for name in _NEEDED))
    tensor: Any = core.Tensor  # its stubs know no arrays
    cloud = t.geometry.PointCloud(tensor(positions))
    values = {
        "intensity": in_unit_range(images["noisy"])[is_echo],
        "clean": in_unit_range(images["clean"])[is_echo],
    }
    for layer, name in (("segmentation", "class"), ("instance", "instance")):
        if layer in images:
            values[name] = images[layer][is_echo].astype(np.int32)
    for name, column in values.items():
        cloud.point[name] = tensor(np.ascontiguousarray(column[:, None]))
    if not t.io.write_point_cloud(path, cloud, write_ascii=False):
        raise FactoryError(f"{path}: cannot be written; is there room on the disk?")
    return len(positions)


def positions_of(
    range_m: Float32s,
    azimuth_rad: Float32s,
    elevation_rad: Float32s,
) -> Float32s:
    """(N, 3) ahead, left and up, m; azimuth is positive to the right."""
    level_m = range_m * np.cos(elevation_rad)
    ahead = level_m * np.cos(azimuth_rad)
    left = -level_m * np.sin(azimuth_rad)
    up = range_m * np.sin(elevation_rad)
    return np.asarray(np.stack([ahead, left, up], axis=-1), np.float32)


_NOTES = """\
`SPLIT/NNNNNN.ply` has the strongest echo of each pixel: x ahead, y left, z up in metres, in the
axes of the sonar; `intensity` and `clean` are the grey values of both images, 0 to 1; `class` and
`instance` number its object, where the dataset is labelled. A sonar cannot tell elevations apart:
they are known here because the scene is. MeshLab, CloudCompare and Open3D read the files.

```python
import open3d

cloud = open3d.t.io.read_point_cloud("train/000000.ply")
print(cloud.point["intensity"].numpy().max())
```
"""
