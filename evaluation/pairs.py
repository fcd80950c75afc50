"""The pairs of a dataset one by one, in any process, and what other programs made of them."""

from __future__ import annotations

import hashlib
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
from ..models.recordings.base import FULL_SCALE
from ..models.recordings.pictures import in_unit_range
from . import image_files
from .filters import REGISTRY
from .filters.base import Gray
from .methods import Method
from .metrics.fidelity import MetricError, finite_psnr
from .metrics.measure import Figures, Picture, Scene, sector_of
from .runner import Subject
from .settings import PicturesFolder

if TYPE_CHECKING:
    from ..factory.sonar.geometry import FanGeometry


_GIVEN = (".png", ".npy")

ROW = -1
"""Stands in a `Place` for: an image file, no shard."""

Place = tuple[str, int]
"""Shard file and row, or a noisy image file and ROW."""


@dataclass(frozen=True)
class Item:
    """One pair: where it is and what it shows.

    split, number: as `simnfnd export --to png` names it; of image files '' and their order.
    key: changes with the content of the pair.
    """

    shard: str
    place: Place
    split: str
    number: int
    key: str
    location: str
    scene: str
    frame: str
    variant: int

    @property
    def group(self) -> str:
        """What shares one clean image: the unit of the bootstrap."""
        return f"{self.location}/{self.scene}/{self.frame}"


def items_of(root: Path, split: Split, limit: int | None = None) -> list[Item]:
    """Every pair of a split (the first `limit`), in the dataset's order.

    root: a dataset, or a folder with noisy/ and clean/ images (`image_files`).
    Raises FactoryError when it is neither.
    """
    if image_files.is_folder_of_pairs(root):
        files = enumerate(image_files.noisy_files(root))
        return [
            Item(f.name, (str(f), ROW), "", n, key, "", root.name, f.stem, 0)
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
    numbers: dict[str, int] = {}
    found = []
    for name, place, key, identity in rows:
        part = name.split("/")[0]
        numbers[part] = numbers.get(part, -1) + 1
        found.append(Item(name, place, part, numbers[part], key, *identity))
    return found[:limit]


def identity_of(file: h5py.File, index: int) -> tuple[str, str, str, int]:
    """(location, scene, frame, variant) of a sample."""
    row = file["meta"][index]
    location, scene, frame = (row[key].decode() for key in ("location", "scene", "frame"))
    return location, scene, frame, int(row["variant"])


def drawn_of(items: Sequence[Item]) -> dict[str, npt.NDArray[Any]]:
    """Column of /meta -> (N,) what it says of each item: numbers (NaN where absent) or text."""
    import pandas as pd

    tables: dict[str, pd.DataFrame] = {}
    for path in dict.fromkeys(item.place[0] for item in items if item.place[1] != ROW):
        with open_shard(Path(path)) as file:
            tables[path] = pd.DataFrame(file["meta"][:])
    rows = [(item.place[0], item.place[1]) for item in items]
    every = pd.concat(tables).reindex(rows) if tables else pd.DataFrame()
    columns = {}
    for name, column in every.items():
        if column.dtype == object:
            text = column.str.decode("utf-8").fillna("")
            columns[str(name)] = text.to_numpy(str)
        else:
            columns[str(name)] = column.to_numpy(float)
    return columns


def config_hash_of(item: Item) -> str:
    """Of the dataset that an item is of; '' for a folder of image files."""
    if item.place[1] == ROW:
        return ""
    with open_shard(Path(item.place[0])) as file:
        value = file.attrs.get("config_hash", "")
        return value.decode() if isinstance(value, bytes) else str(value)


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

    def key(self) -> str:
        """The content of the pair, and what is measured."""
        texture = "texture" if self.texture else "plain"
        return f"{self.item.key}-{texture}-{self.shadow_threshold:g}"

    def seen(self) -> Gray:
        """The noisy image (H, W)."""
        return picture(self.item.place).noisy

    def geometry(self) -> FanGeometry | None:
        """Where range and bearing are, as the dataset says."""
        return geometry_of(self.item.place)

    def given(self, method: Method) -> Gray:
        """See `Subject`."""
        return _read_given(method.given, self.item, picture(self.item.place).noisy.shape)

    def measure(self, image: Gray) -> Figures:
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


def given_methods(folders: Sequence[PicturesFolder], items: Sequence[Item]) -> list[Method]:
    """A row for each folder of denoised pictures.

    Raises FactoryError, one line, for a folder that lacks a picture of the split.
    """
    found: dict[str, Method] = {}
    for one in folders:
        if one.name in (*found, *REGISTRY, "noisy"):
            raise FactoryError(f"pictures: {one.name}: another row has this name; choose another")
        found[one.name] = Method(one.name, "", {}, given=one.dir, content=_content(one, items))
    return list(found.values())


def _read_given(folder: str, item: Item, shape: tuple[int, ...]) -> Gray:
    """(H, W) float32 in 0..1, H and W as in `shape`: what the folder has of a pair.

    Of .npy files whole numbers count by their full scale, floats as they are, what overshoots
    clipped.  Raises FactoryError.
    """
    path = _given_file(Path(folder), item)
    if path is None:
        raise FactoryError(f"{folder}: no picture {_names(item)[0]}.png or .npy")
    if path.suffix == ".npy":
        try:
            array = np.load(path, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise FactoryError(f"{path}: not a readable .npy file ({error})") from error
        if array.dtype.kind == "f":
            low, high = float(array.min()), float(array.max())
            if not -0.5 <= low <= high <= 1.5:
                what = f"pixels of {low:g} .. {high:g}; floats must lie in 0..1"
                raise FactoryError(f"{path}: {what}")
            array = np.clip(array, 0, 1).astype(np.float32)
        if str(array.dtype) not in FULL_SCALE:
            raise FactoryError(f"{path}: {array.dtype} pixels; give {', '.join(FULL_SCALE)}")
        image = in_unit_range(array, str(path))
    else:
        image = image_files.read_gray(path)
    if image.shape != shape:
        sizes = ["x".join(map(str, reversed(one))) for one in (image.shape, shape)]
        raise FactoryError(f"{path}: {sizes[0]} pixels, but its pair has {sizes[1]}")
    return image


def _content(given: PicturesFolder, items: Sequence[Item]) -> str:
    """Changes with the files of a folder of denoised pictures."""
    folder = Path(given.dir).expanduser()
    where = f"pictures: {given.name}: {folder}"
    if not folder.is_dir():
        raise FactoryError(f"{where}: no such folder")
    files = [_given_file(folder, item) for item in items]
    lacking = [item for item, file in zip(items, files, strict=True) if file is None]
    if lacking:
        raise FactoryError(
            f"{where}: {len(lacking)} of {len(items)} pictures are missing, the first is "
            f"{_names(lacking[0])[0]}.png (or .npy); names are those of `simnfnd export --to png` "
            "and of `simnfnd denoise`"
        )
    digest = hashlib.blake2b(digest_size=12)
    for file in filter(None, files):
        digest.update(f"{file} {file.stat().st_size} {file.stat().st_mtime_ns}\n".encode())
    return digest.hexdigest()


def _names(item: Item) -> list[str]:
    """Where a picture may lie, without its suffix: as `export --to png` and `denoise` name it."""
    if item.place[1] == ROW:
        stem = Path(item.place[0]).stem
        return [stem, f"noisy/{stem}"]
    number = f"{item.number:06d}"
    return [f"{item.split}/noisy/{number}", f"{item.split}/{number}", f"noisy/{number}", number]


def _given_file(folder: Path, item: Item) -> Path | None:
    paths = (folder.expanduser() / f"{n}{suffix}" for n in _names(item) for suffix in _GIVEN)
    return next((path for path in paths if path.is_file()), None)
