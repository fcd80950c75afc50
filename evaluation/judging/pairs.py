"""The pairs of a dataset one by one, in any process."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ...factory.common.array_types import Array
from ...factory.common.errors import FactoryError
from ...factory.common.files import sha256_of
from ...factory.dataset.manifest import load_manifest
from ...factory.dataset.pair_dataset import PairDataset
from ...factory.dataset.reader import ImageStack, Split, open_shard, reading, value_range
from ...factory.dataset.schema import CORE
from ...models.recordings.base import SonarFrame
from ...models.recordings.images import read_image
from ...models.recordings.views import grey_of
from ..filters import REGISTRY
from ..metrics.fidelity import MetricError, finite_psnr
from ..metrics.measure import Figures, Grey, MeasuredPair, PairImages, sector_of
from ..metrics.own import own_figures
from .methods import Method
from .runner import Denoised, ImageSubject
from .settings import ImagesFolder

if TYPE_CHECKING:
    import pandas as pd

    from ...factory.dataset.fan_geometry import FanGeometry

Place = tuple[str, int]
"""Shard file and row."""


@dataclass(frozen=True)
class JudgedPair(ImageSubject):
    """One pair: where it is, what it shows, and what is measured of it.

    split, number: as `simnfnd export --to png` names it.
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

    @property
    def title(self) -> str:
        """What people call it."""
        return f"{self.scene} {self.frame}" + (f" #{self.variant}" if self.variant else "")

    def noisy_image(self) -> Grey:
        """The noisy image (H, W)."""
        return pair_images(self.place).noisy

    def geometry(self) -> FanGeometry | None:
        """Where range and bearing are, as the dataset says."""
        return geometry_of(self.place)

    def read(self) -> tuple[Grey, FanGeometry | None]:
        """The noisy image and its geometry."""
        return self.noisy_image(), self.geometry()

    def denoise(self, method: Method, device: str) -> Denoised:
        """See `Subject`; another program's image is read."""
        if not method.images_source:
            return super().denoise(method, device)
        shape = self.noisy_image().shape
        return external_result(Path(method.images_source), names_of(self), shape)

    def measure(self, image: Array) -> Figures:
        """All metrics; identical images count as the PSNR of `finite_psnr`."""
        try:
            scene = _scene(self)
            figures = {**scene.figures(image), **own_figures(image, scene.pair)}
        except MetricError as error:
            raise FactoryError(f"{self.shard}: sample {self.place[1]}: {error}") from error
        return {n: finite_psnr(v) if n.startswith("psnr") else v for n, v in figures.items()}


def items_of(root: Path, split: Split, limit: int | None = None) -> list[JudgedPair]:
    """Every pair of a split (the first `limit`), in the dataset's order.

    Raises FactoryError when `root` is no dataset.
    """
    pairs = PairDataset(root, split)
    manifest = load_manifest(root)
    digests = {}
    counts = dict.fromkeys(pairs.splits, 0)
    for path in pairs.paths:
        name = path.relative_to(root).as_posix()
        digests[path] = name, manifest.shards[name].sha256 if manifest else sha256_of(path)
    items = []
    for sample in pairs.names():
        name, digest = digests[sample.path]
        place = (str(sample.path), sample.row)
        key = f"{digest[:24]}:{sample.row}"
        identity = sample.location, sample.scene, sample.frame, sample.variant
        items.append(JudgedPair(name, place, sample.split, counts[sample.split], key, *identity))
        counts[sample.split] += 1
    return items[:limit]


def drawn_of(items: Sequence[JudgedPair]) -> pd.DataFrame:
    """(items x columns of /meta) what was drawn: numbers, NaN where absent, or text."""
    import pandas as pd

    tables: dict[str, pd.DataFrame] = {}
    for path in dict.fromkeys(item.place[0] for item in items):
        with open_shard(Path(path)) as file:
            tables[path] = pd.DataFrame(file["meta"][:])
    every = pd.concat(tables).reindex([item.place for item in items])
    text = every.select_dtypes(object)
    every[text.columns] = text.apply(lambda column: column.str.decode("utf-8")).fillna("")
    numbers = dict.fromkeys((name for name in every if name not in text), float)
    return every.astype(numbers).reset_index(drop=True)


def config_hash_of(item: JudgedPair) -> str:
    """Hash of the configuration of an item's dataset."""
    with open_shard(Path(item.place[0])) as file:
        return str(file.attrs["config_hash"])


@lru_cache(maxsize=16)
def pair_images(place: Place) -> PairImages:
    """Read one pair.  FactoryError when it is damaged or has NaN."""
    path, row = place
    with reading(Path(path)) as file:
        scale = np.float32(value_range(file))
        stored, truth, shadow = (ImageStack(file[key])[row] for key in CORE)
    noisy, clean = (image.astype(np.float32) / scale for image in (stored, truth))
    if not (np.isfinite(noisy).all() and np.isfinite(clean).all()):
        raise FactoryError(f"{path}: sample {row} has NaN or infinite pixels")
    shadow = shadow.astype(bool)
    return PairImages(noisy, clean, shadow, sector_of(noisy, clean, shadow))


@lru_cache(maxsize=64)
def geometry_of(place: Place) -> FanGeometry | None:
    """Where range and bearing are in an image of a dataset; None where nothing says so."""
    from ...factory.dataset.fan_geometry import FanGeometry, recorded_sonar

    path, row = place
    with open_shard(Path(path)) as file:
        try:
            sonar = recorded_sonar(json.loads(file.attrs["config"]))
            return None if sonar is None else FanGeometry.from_record(sonar, file["meta"][row])
        except (KeyError, ValueError, TypeError):
            return None


@lru_cache(maxsize=8)
def _scene(item: JudgedPair) -> MeasuredPair:
    """What all methods share on a pair."""
    return MeasuredPair(pair_images(item.place))


def names_of(item: JudgedPair) -> list[str]:
    """Where another program's image may lie, without its suffix.

    As `simnfnd export --to png` and `simnfnd denoise` name it.
    """
    number = f"{item.number:06d}"
    return [f"{item.split}/noisy/{number}", f"{item.split}/{number}", f"noisy/{number}", number]


_GIVEN = (".png", ".npy")


def given_file(folder: Path, names: Sequence[str]) -> Path | None:
    """The file of another program's denoised image, PNG or .npy, by the first of its names."""
    paths = (folder.expanduser() / f"{name}{suffix}" for name in names for suffix in _GIVEN)
    return next((path for path in paths if path.is_file()), None)


def read_external_image(folder: Path, names: Sequence[str]) -> Grey:
    """(H, W) float32 in 0..1 of that file.  FactoryError when it is none, or in colour."""
    path = given_file(folder, names)
    if path is None:
        raise FactoryError(f"{folder}: no image {names[0]}.png or .npy")
    image = read_image(path)
    if image.ndim == 3:
        if (image[..., :3] != image[..., :1]).any():
            raise FactoryError(f"{path}: in colour; sonar images are grey, convert it first")
        image = image[..., 0]
    return grey_of(SonarFrame(0, image))


def external_result(folder: Path, names: Sequence[str], shape: tuple[int, ...]) -> Denoised:
    """Another program's image of a subject of this shape.  Raises FactoryError."""
    image = read_external_image(folder, names)
    if image.shape != shape:
        sizes = ["x".join(map(str, reversed(size))) for size in (image.shape, shape)]
        raise FactoryError(f"{names[0]}: {sizes[0]} pixels, but what is judged has {sizes[1]}")
    return Denoised(image)


def given_methods(folders: Sequence[ImagesFolder], names: Sequence[Sequence[str]]) -> list[Method]:
    """A row for each folder of another program's denoised images.

    names: of each image, where it may lie there.  Raises FactoryError for a folder without one.
    """
    methods: dict[str, Method] = {}
    for folder in folders:
        if folder.name in (*methods, *REGISTRY, "noisy"):
            raise FactoryError(
                f"pictures: {folder.name}: another row has this name; choose another"
            )
        place = Path(folder.dir)
        lacking = [some_names[0] for some_names in names if given_file(place, some_names) is None]
        if lacking:
            raise FactoryError(
                f"pictures: {folder.name}: {folder.dir}: {len(lacking)} of {len(names)} "
                f"images are missing, the first is {lacking[0]}.png (or .npy); names are those "
                "of `simnfnd export --to png` and of `simnfnd denoise`"
            )
        methods[folder.name] = Method(folder.name, "", {}, images_source=folder.dir)
    return list(methods.values())
