"""Image files: folders of pairs, and folders of pictures that another program denoised.

A folder of pairs holds noisy/ and clean/, perhaps shadow/, with equal file names.

Rules: 8 bits count to 255, 16 bits to 65535, floats lie in 0..1.  A colour image counts when its
channels are equal; transparency is left out.  Both images of a pair have one size; pairs may
differ.  `shadow/` holds masks, any value above 0 is shadow; without it shadow metrics do not exist.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..factory.errors import FactoryError
from ..factory.files import sha256_of
from ..models.recordings import PICTURE_SUFFIXES, SEQUENCES, kind_of
from ..models.recordings.arrays import is_table
from ..models.recordings.pictures import in_unit_range, read_picture
from .filters import REGISTRY
from .filters.base import Gray
from .item import ROW, Item
from .methods import Method
from .settings import PicturesFolder

_GIVEN = (".png", ".npy")


def is_folder_of_pairs(root: Path) -> bool:
    """Whether there are both folders."""
    return (root / "noisy").is_dir() and (root / "clean").is_dir()


def noisy_files(root: Path) -> list[tuple[Path, str]]:
    """The noisy files in the order of their names, with a key of each pair's content.

    Raises FactoryError for an image without its partner, and when there is none at all.
    """
    names = {
        part: sorted(path.name for path in images_in(root / part)) for part in ("noisy", "clean")
    }
    for part, other in (("noisy", "clean"), ("clean", "noisy")):
        lonely = sorted(set(names[part]) - set(names[other]))
        if lonely:
            more = f" (and {len(lonely) - 1} more)" if len(lonely) > 1 else ""
            raise FactoryError(f"{root / part / lonely[0]}: no partner in {other}/{more}")
    if not names["noisy"]:
        raise FactoryError(f"dataset={root}: noisy/ and clean/ hold no images {PICTURE_SUFFIXES}")
    found = []
    for name in names["noisy"]:
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


def read_given(folder: str, item: Item, shape: tuple[int, ...]) -> Gray:
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
                raise FactoryError(
                    f"{path}: pixels of {low:g} .. {high:g}; floats must lie in 0..1"
                )
            array = np.clip(array, 0, 1).astype(np.float32)
        if str(array.dtype) not in ("uint8", "uint16", "float32"):
            raise FactoryError(
                f"{path}: {array.dtype} pixels; give uint8, uint16 or floats in 0..1"
            )
        image = in_unit_range(array, str(path))
    else:
        image = read_gray(path)
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
