"""The pairs of a dataset one by one, in any process, with all looks at each frame."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import numpy.typing as npt

from ..factory.dataset.format.manifest import load_manifest
from ..factory.dataset.read.image_stack import ImageStack
from ..factory.dataset.read.reader import (
    Split,
    open_shard,
    reading,
    shard_paths,
    value_range,
)
from ..factory.dataset.read.source import CORE
from ..factory.errors import FactoryError
from ..factory.files import sha256_of
from . import image_files
from .filters.base import Gray
from .item import ROW, Item, Place
from .metrics.fidelity import MetricError, finite_psnr
from .metrics.measure import Figures, Picture, Scene, sector_of
from .runner import MethodFailed, Subject

if TYPE_CHECKING:
    from ..factory.sonar.geometry import FanGeometry
    from .methods import Method


def items_of(root: Path, split: Split, limit: int | None = None) -> list[Item]:
    """Every pair of a split (the first `limit`), in the dataset's order.

    root: a dataset, or a folder with noisy/ and clean/ images (`image_files`).
    Raises FactoryError when it is neither.
    """
    if image_files.is_folder_of_pairs(root):
        files = enumerate(image_files.noisy_files(root))
        return [
            Item(f.name, (str(f), ROW), "", n, key, "", root.name, f.stem, 0, ())
            for n, (f, key) in files
        ][:limit]
    manifest = load_manifest(root) if root.is_dir() else None
    rows: list[tuple[str, Place, str, tuple[str, str, str, int]]] = []
    for path in shard_paths(root, split):
        name = path.relative_to(root).as_posix()
        digest = manifest.shards[name].sha256 if manifest is not None else sha256_of(path)
        with open_shard(path) as file:
            rows += [
                (name, (str(path), row), f"{digest[:24]}:{row}", identity_of(file, row))
                for row in range(len(file["noisy"]))
            ]
    if not rows:
        raise FactoryError(f"dataset={root}: its shards hold no samples")
    frames: dict[tuple[str, str, str], list[Place]] = {}
    for _, place, _, identity in rows:
        frames.setdefault(identity[:3], []).append(place)
    numbers: dict[str, int] = {}
    found = []
    for name, place, key, identity in rows:
        part = name.split("/")[0]
        numbers[part] = numbers.get(part, -1) + 1
        looks = (*(one for one in frames[identity[:3]] if one != place), place)
        found.append(Item(name, place, part, numbers[part], key, *identity, looks))
    return found[:limit]


def identity_of(file: h5py.File, index: int) -> tuple[str, str, str, int]:
    """(location, scene, frame, variant) of a sample."""
    row = file["meta"][index]
    location, scene, frame = (row[key].decode() for key in ("location", "scene", "frame"))
    return location, scene, frame, int(row["variant"])


def drawn_of(items: Sequence[Item]) -> dict[str, npt.NDArray[Any]]:
    """Column of /meta -> (N,) what it says of each item: numbers (NaN where absent) or text."""
    tables: dict[str, npt.NDArray[Any]] = {}
    for path in dict.fromkeys(item.place[0] for item in items if item.place[1] >= 0):
        with open_shard(Path(path)) as file:
            tables[path] = file["meta"][:]
    columns = {}
    for name in dict.fromkeys(name for t in tables.values() for name in t.dtype.names or ()):
        values = [
            table[item.place[1]][name]
            if (table := tables.get(item.place[0])) is not None
            and name in (table.dtype.names or ())
            else np.nan
            for item in items
        ]
        if any(isinstance(value, bytes) for value in values):
            values = [value.decode() if isinstance(value, bytes) else "" for value in values]
            columns[name] = np.array(values)
        else:
            columns[name] = np.array(values, float)
    return columns


@lru_cache(maxsize=16)
def picture(place: Place) -> Picture:
    """Read one pair.  FactoryError when it is damaged or has NaN."""
    path, row = place
    if row == ROW:
        noisy, clean, mask = image_files.read_pair(Path(path))
        shadow = np.zeros(clean.shape, bool) if mask is None else mask
        sector = sector_of(noisy, clean, shadow)
        return Picture(noisy, clean, shadow, sector, has_shadow=mask is not None)
    with reading(Path(path)) as file:
        full = value_range(file)
        noisy, clean, shadow = (ImageStack(file[key])[row] for key in CORE)
    for name, image in (("noisy", noisy), ("clean", clean)):
        if not np.isfinite(image).all():
            raise FactoryError(f"{path}: sample {row}: {name} has NaN or infinite pixels")
    shadow = shadow.astype(bool)
    scale = np.float32(full)
    return Picture(
        noisy.astype(np.float32) / scale,
        clean.astype(np.float32) / scale,
        shadow,
        sector_of(noisy, clean, shadow),
    )


@lru_cache(maxsize=64)
def geometry_of(place: Place) -> FanGeometry | None:
    """Where range and bearing are in a picture of a dataset; None where nothing says so."""
    from ..factory.sonar.geometry import FanGeometry, recorded_sonar

    path, row = place
    if row == ROW:
        return None
    with open_shard(Path(path)) as file:
        try:
            sonar = recorded_sonar(json.loads(file.attrs["config"]))
            return None if sonar is None else FanGeometry.from_record(sonar, file["meta"][row])
        except (KeyError, ValueError, TypeError):
            return None


@dataclass(frozen=True)
class Pair(Subject):
    """A pair as the engine judges methods on it.

    shadow_threshold: fraction of full scale.  texture: also measure speckle and edges.
    """

    item: Item
    shadow_threshold: float
    texture: bool

    def key(self, method: Method) -> str:
        """The content of the pair and of the looks at it, and what is measured."""
        looks = f"+{len(self.item.looks)}" if method.looks else ""
        texture = "texture" if self.texture else "plain"
        return f"{self.item.key}{looks}-{texture}-{self.shadow_threshold:g}"

    def seen(self, method: Method) -> Gray:
        """The noisy image (H, W), or all looks at it (T, H, W), this one last."""
        if not method.looks:
            return picture(self.item.place).noisy
        if len(self.item.looks) < 2:
            raise MethodFailed("needs several noise variants a frame")
        return np.stack([picture(place).noisy for place in self.item.looks])

    def geometry(self) -> FanGeometry | None:
        """Where range and bearing are, as the dataset says."""
        return geometry_of(self.item.place)

    def given(self, method: Method) -> Gray:
        """The picture that another program made of it."""
        return image_files.read_given(method.given, self.item, picture(self.item.place).noisy.shape)

    def measure(self, image: Gray, method: Method) -> Figures:
        """All metrics; identical images count as the PSNR of `finite_psnr`."""
        try:
            found = _scene(self.item).figures(
                image, shadow_threshold=self.shadow_threshold, texture=self.texture
            )
        except MetricError as error:
            raise FactoryError(
                f"{self.item.shard}: sample {self.item.place[1]}: {error}"
            ) from error
        return {n: finite_psnr(v) if n.startswith("psnr") else v for n, v in found.items()}


@lru_cache(maxsize=8)
def _scene(item: Item) -> Scene:
    """What all methods share on a pair."""
    return Scene(picture(item.place))
