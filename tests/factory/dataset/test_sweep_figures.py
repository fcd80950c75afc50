"""Figures of the points of a sweep: of which pairs they are, and which points are equal."""

from __future__ import annotations

from pathlib import Path

import h5py
import numpy as np
import pytest

from simnfnd.factory.dataset.quality import images_digest, lit_share
from simnfnd.factory.production.cli.sweep import equal_points


def write_shards(folder: Path, levels: list[list[int]]) -> Path:
    """A shard for each list: an image of 16 x 16 of each level, clean and noisy alike."""
    for number, shard_levels in enumerate(levels):
        path = folder / "train" / f"shard-{number:05d}.h5"
        path.parent.mkdir(parents=True, exist_ok=True)
        images = np.stack([np.full((16, 16), level, np.uint8) for level in shard_levels])
        with h5py.File(path, "w") as shard:
            shard["clean"] = images
            shard["noisy"] = images
    return folder


@pytest.mark.parametrize("most", [2, 4, 8])
def test_figures_are_of_pairs_from_the_whole_dataset(tmp_path: Path, most: int) -> None:
    """The first half of the dataset is lit, the second dark."""
    dataset = write_shards(tmp_path, [[9, 9, 9], [9], [0, 0], [0, 0]])
    assert lit_share(dataset, most) == 0.5


def test_points_with_equal_images_are_named(tmp_path: Path) -> None:
    digests = []
    for name, checksum in (("a", 1), ("b", 2), ("c", 1)):
        path = tmp_path / name / "train" / "shard-00000.h5"
        path.parent.mkdir(parents=True)
        checksums = np.array([(checksum, 7)], [("clean", "<u4"), ("noisy", "<u4")])
        with h5py.File(path, "w") as shard:
            shard["checksums"] = checksums
        digests.append(images_digest(tmp_path / name))
    rows = [{"images": digest} for digest in digests]
    (line,) = equal_points(rows)
    assert "points 0, 2 " in line
    assert not list(equal_points([*rows[:2], {"failed": "yes"}]))
