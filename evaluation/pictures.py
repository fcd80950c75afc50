"""The pairs of a dataset one by one, in any process, with all looks at each frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from evaluation import metrics
from evaluation.baselines.base import Gray
from evaluation.measure import identity_of, sector_of
from factory.errors import FactoryError
from factory.shards.reader import Split, open_shard, shard_paths, value_range

Place = tuple[str, int]
"""Shard file and row."""


@dataclass(frozen=True)
class Item:
    """One pair: where it is and what it shows.

    looks: the noise variants of the same frame in the same split, this one last; methods of
    several looks see all of them.
    """

    shard: str
    place: Place
    location: str
    scene: str
    frame: str
    variant: int
    looks: tuple[Place, ...]

    @property
    def group(self) -> str:
        """What shares one clean image: the unit of the bootstrap."""
        return f"{self.location}/{self.scene}/{self.frame}"


@dataclass(frozen=True)
class Picture:
    """noisy, clean: (H, W) float32 in 0..1; shadow, sector: (H, W) bool."""

    noisy: Gray
    clean: Gray
    shadow: npt.NDArray[np.bool_]
    sector: npt.NDArray[np.bool_]


def items_of(root: Path, split: Split) -> list[Item]:
    """Every pair of a split, in the dataset's order.  FactoryError: no readable dataset."""
    rows: list[tuple[str, Place, tuple[str, str, str, int]]] = []
    for path in shard_paths(root, split):
        name = path.relative_to(root).as_posix()
        with open_shard(path) as file:
            rows += [
                (name, (str(path), row), identity_of(file, row))
                for row in range(len(file["noisy"]))
            ]
    if not rows:
        raise FactoryError(f"dataset={root}: its shards hold no samples")
    frames: dict[tuple[str, str, str], list[Place]] = {}
    for _, place, identity in rows:
        frames.setdefault(identity[:3], []).append(place)
    return [
        Item(name, place, *identity, (*(p for p in frames[identity[:3]] if p != place), place))
        for name, place, identity in rows
    ]


@lru_cache(maxsize=32)
def picture(place: Place) -> Picture:
    """Read one pair.  FactoryError when it is damaged, MetricError when it is not a number."""
    path, row = place
    with open_shard(Path(path)) as file:
        full = value_range(file)
        try:
            noisy, clean, shadow = (file[key][row] for key in ("noisy", "clean", "shadow"))
        except OSError as error:
            raise FactoryError(f"{path}: sample {row} is damaged; generate it again") from error
    for name, image in (("noisy", noisy), ("clean", clean)):
        if not np.isfinite(image).all():
            raise metrics.MetricError(f"{path}: sample {row}: {name} has NaN or infinite pixels")
    shadow = shadow.astype(bool)
    scale = np.float32(full)
    return Picture(
        noisy.astype(np.float32) / scale,
        clean.astype(np.float32) / scale,
        shadow,
        sector_of(noisy, clean, shadow),
    )


def input_of(item: Item, looks: bool) -> Gray:
    """What a method gets: the noisy image (H, W), or all looks at it (T, H, W)."""
    if not looks:
        return picture(item.place).noisy
    return np.stack([picture(place).noisy for place in item.looks])
