"""The pairs of a dataset one by one, in any process."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ..factory.dataset.manifest import load_manifest
from ..factory.dataset.pair_dataset import PairDataset
from ..factory.dataset.reader import ImageStack, Split, open_shard, reading, value_range
from ..factory.dataset.schema import CORE
from ..factory.errors import FactoryError
from ..factory.files import sha256_of
from ..models.recordings import PICTURE_SUFFIXES, SEQUENCES, kind_of
from ..models.recordings.arrays import is_table
from ..models.recordings.pictures import in_unit_range, read_picture
from .filters import REGISTRY
from .methods import Method
from .metrics.fidelity import MetricError, finite_psnr
from .metrics.measure import Figures, Gray, Picture, Scene, sector_of
from .runner import Subject
from .settings import PicturesFolder

if TYPE_CHECKING:
    from ..factory.sonar.geometry import FanGeometry

ROW = -1
"""Stands in a `Place` for: an image file, no shard."""

Place = tuple[str, int]
"""Shard file and row, or a noisy image file and ROW."""


@dataclass(frozen=True)
class Item(Subject):
    """One pair: where it is, what it shows, and what is measured of it.

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

    def seen(self) -> Gray:
        """The noisy image (H, W)."""
        return picture(self.place).noisy

    def geometry(self) -> FanGeometry | None:
        """Where range and bearing are, as the dataset says."""
        return geometry_of(self.place)

    def given(self, method: Method) -> Gray:
        """See `Subject`."""
        image = given_picture(Path(method.given), names_of(self))
        if image.shape != (shape := self.seen().shape):
            sizes = ["x".join(map(str, reversed(one))) for one in (image.shape, shape)]
            name = names_of(self)[0]
            raise FactoryError(f"{name}: {sizes[0]} pixels, but its pair has {sizes[1]}")
        return image

    def measure(self, image: Gray) -> Figures:
        """All metrics; identical images count as the PSNR of `finite_psnr`."""
        try:
            found = _scene(self).figures(image)
        except MetricError as error:
            raise FactoryError(f"{self.shard}: sample {self.place[1]}: {error}") from error
        return {n: finite_psnr(v) if n.startswith("psnr") else v for n, v in found.items()}


def items_of(root: Path, split: Split, limit: int | None = None) -> list[Item]:
    """Every pair of a split (the first `limit`), in the dataset's order.

    root: a dataset, or a folder with noisy/ and clean/ images.
    Raises FactoryError when it is neither.
    """
    if is_folder_of_pairs(root):
        files = enumerate(noisy_files(root))
        return [
            Item(f.name, (str(f), ROW), "", n, key, "", root.name, f.stem, 0)
            for n, (f, key) in files
        ][:limit]
    pairs, manifest = PairDataset(root, split), load_manifest(root)
    digests, counts = {}, dict.fromkeys(pairs.splits, 0)
    for path in pairs.paths:
        name = path.relative_to(root).as_posix()
        digests[path] = name, manifest.shards[name].sha256 if manifest else sha256_of(path)
    found = []
    for one in pairs.names():
        name, digest = digests[one.path]
        place, key = (str(one.path), one.row), f"{digest[:24]}:{one.row}"
        identity = one.location, one.scene, one.frame, one.variant
        found.append(Item(name, place, one.split, counts[one.split], key, *identity))
        counts[one.split] += 1
    return found[:limit]


def drawn_of(items: Sequence[Item]) -> dict[str, npt.NDArray[Any]]:
    """Column of /meta -> (N,) what it says of each item: numbers (NaN where absent) or text."""
    import pandas as pd

    tables: dict[str, pd.DataFrame] = {}
    for path in dict.fromkeys(item.place[0] for item in items if item.place[1] != ROW):
        with open_shard(Path(path)) as file:
            tables[path] = pd.DataFrame(file["meta"][:])
    every = pd.concat(tables).reindex([item.place for item in items]) if tables else pd.DataFrame()
    text = every.select_dtypes(object)
    every[text.columns] = text.apply(lambda column: column.str.decode("utf-8")).fillna("")
    return {
        str(name): column.to_numpy(str if name in text else float) for name, column in every.items()
    }


def config_hash_of(item: Item) -> str:
    """Of the dataset that an item is of; '' for a folder of image files."""
    if item.place[1] == ROW:
        return ""
    with open_shard(Path(item.place[0])) as file:
        return str(file.attrs["config_hash"])


@lru_cache(maxsize=16)
def picture(place: Place) -> Picture:
    """Read one pair.  FactoryError when it is damaged or has NaN."""
    path, row = place
    if row == ROW:
        noisy, clean, mask = read_pair(Path(path))
        shadow = np.zeros(clean.shape, bool) if mask is None else mask
        sector = sector_of(noisy, clean, shadow)
        return Picture(noisy, clean, shadow, sector, has_shadow=mask is not None)
    with reading(Path(path)) as file:
        scale = np.float32(value_range(file))
        stored, truth, shadow = (ImageStack(file[key])[row] for key in CORE)
    noisy, clean = (image.astype(np.float32) / scale for image in (stored, truth))
    if not (np.isfinite(noisy).all() and np.isfinite(clean).all()):
        raise FactoryError(f"{path}: sample {row} has NaN or infinite pixels")
    shadow = shadow.astype(bool)
    return Picture(noisy, clean, shadow, sector_of(noisy, clean, shadow))


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


@lru_cache(maxsize=8)
def _scene(item: Item) -> Scene:
    """What all methods share on a pair."""
    return Scene(picture(item.place))


def names_of(item: Item) -> list[str]:
    """Where another program's picture may lie, without its suffix.

    As `simnfnd export --to png` and `simnfnd denoise` name it.
    """
    if item.place[1] == ROW:
        stem = Path(item.place[0]).stem
        return [stem, f"noisy/{stem}"]
    number = f"{item.number:06d}"
    return [f"{item.split}/noisy/{number}", f"{item.split}/{number}", f"noisy/{number}", number]


_GIVEN = (".png", ".npy")


def is_folder_of_pairs(root: Path) -> bool:
    """Whether there are both folders."""
    return (root / "noisy").is_dir() and (root / "clean").is_dir()


def noisy_files(root: Path) -> list[tuple[Path, str]]:
    """The noisy files in the order of their names, with a key of each pair's content.

    Raises FactoryError for an image without its partner, and when there is none at all.
    """
    noisy, clean = ({one.name for one in images_in(root / part)} for part in ("noisy", "clean"))
    for part, lonely, other in (
        ("noisy", noisy - clean, "clean"),
        ("clean", clean - noisy, "noisy"),
    ):
        if lonely:
            raise FactoryError(
                f"{root / part / min(lonely)}: no partner in {other}/ ({len(lonely)} such files)"
            )
    if not noisy:
        raise FactoryError(f"dataset={root}: noisy/ and clean/ hold no images {PICTURE_SUFFIXES}")
    found = []
    for name in sorted(noisy):
        files = [root / part / name for part in ("noisy", "clean", "shadow")]
        digests = [sha256_of(file)[:16] for file in files if file.is_file()]
        found.append((files[0], "-".join(digests)))
    return found


def images_in(folder: Path) -> list[Path]:
    """The image files of a folder, by name."""
    return sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in PICTURE_SUFFIXES and path.is_file() and not is_table(path)
    )


def read_pair(noisy: Path) -> tuple[Gray, Gray, npt.NDArray[np.bool_] | None]:
    """(noisy, clean, shadow or None), (H, W) in 0..1.  FactoryError names a file that is unfit."""
    root = noisy.parents[1]
    clean, mask = root / "clean" / noisy.name, root / "shadow" / noisy.name
    images = read_gray(noisy), read_gray(clean)
    if images[0].shape != images[1].shape:
        sizes = [f"{image.shape[1]}x{image.shape[0]}" for image in images]
        raise FactoryError(f"{noisy}: {sizes[0]}, but its clean image is {sizes[1]} pixels")
    if not mask.is_file():
        return *images, None
    shadow = read_gray(mask) > 0
    if shadow.shape != images[0].shape:
        raise FactoryError(f"{mask}: another size than the image that it belongs to")
    return *images, shadow


def given_file(folder: Path, names: Sequence[str]) -> Path | None:
    """The file of somebody's denoised picture, PNG or .npy, by the first of its names."""
    paths = (folder.expanduser() / f"{name}{suffix}" for name in names for suffix in _GIVEN)
    return next((path for path in paths if path.is_file()), None)


def given_picture(folder: Path, names: Sequence[str]) -> Gray:
    """(H, W) float32 in 0..1 of that file.  Raises FactoryError."""
    path = given_file(folder, names)
    if path is None:
        raise FactoryError(f"{folder}: no picture {names[0]}.png or .npy")
    return read_gray(path)


def read_gray(path: Path) -> Gray:
    """(H, W) float32 in 0..1 of an image file.  FactoryError when it is none, or in colour."""
    if kind_of(path) in SEQUENCES:
        raise FactoryError(f"{path}: holds several pages; give each pair files of its own")
    image = read_picture(path)
    if image.ndim == 3:
        colours = image[..., :3]
        if colours.shape[2] == 3 and not (colours == colours[..., :1]).all():
            raise FactoryError(f"{path}: in colour; sonar images are gray, convert it first")
        image = colours[..., 0]
    return in_unit_range(image, str(path))


def given_methods(
    folders: Sequence[PicturesFolder], names: Sequence[Sequence[str]]
) -> list[Method]:
    """A row for each folder of another program's denoised pictures.

    names: of each picture, where it may lie there.  Raises FactoryError for a folder without one.
    """
    found: dict[str, Method] = {}
    for one in folders:
        if one.name in (*found, *REGISTRY, "noisy"):
            raise FactoryError(f"pictures: {one.name}: another row has this name; choose another")
        files = [given_file(Path(one.dir), several) for several in names]
        if lacking := [some[0] for some, file in zip(names, files, strict=True) if file is None]:
            raise FactoryError(
                f"pictures: {one.name}: {one.dir}: {len(lacking)} of {len(names)} pictures are "
                f"missing, the first is {lacking[0]}.png (or .npy); names are those of `simnfnd "
                "export --to png` and of `simnfnd denoise`"
            )
        digest = hashlib.blake2b(digest_size=12)
        for file in filter(None, files):
            digest.update(f"{file} {file.stat().st_size} {file.stat().st_mtime_ns}\n".encode())
        found[one.name] = Method(one.name, "", {}, given=one.dir, content=digest.hexdigest())
    return list(found.values())
