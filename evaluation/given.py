"""Denoised pictures of somebody else's program: a folder of files as a row of the report."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from ..factory.dataset.read.reader import reading
from ..factory.errors import FactoryError
from ..models.recordings.pictures import in_unit_range
from .filters import REGISTRY
from .filters.base import Gray
from .image_files import read_gray
from .methods.method import Method
from .pairs import Item, picture
from .settings import PicturesFolder

SUFFIXES = (".png", ".npy")


def given_methods(folders: Sequence[PicturesFolder], items: Sequence[Item]) -> list[Method]:
    """A row for each folder.

    Raises FactoryError, one line, for a folder that lacks a picture of the split or has one of
    another size.
    """
    names = [one.name for one in folders]
    for name in names:
        if names.count(name) > 1 or name in (*REGISTRY, "noisy"):
            raise FactoryError(f"pictures: {name}: another row has this name; choose another")
    return [
        Method(one.name, "", {}, given=one.dir, content=_checked(one, items)) for one in folders
    ]


def read_given(folder: str, item: Item) -> Gray:
    """(H, W) float32 in 0..1: what the folder has of a pair.  Raises FactoryError."""
    path = _file_of(Path(folder), item)
    if path is None:
        raise FactoryError(f"{folder}: no picture {_names(item)[0]}.png or .npy")
    if path.suffix == ".npy":
        try:
            array = np.load(path, allow_pickle=False)
        except (OSError, ValueError) as error:
            raise FactoryError(f"{path}: not a readable .npy file ({error})") from error
        found = _in_unit_range(array, path)
    else:
        found = read_gray(path)
    wanted = picture(item.place).noisy.shape
    if found.shape != wanted:
        raise FactoryError(f"{path}: {_size(found.shape)} pixels, but its pair has {_size(wanted)}")
    return found


def _in_unit_range(array: npt.NDArray[np.generic], path: Path) -> Gray:
    """Whole numbers by their full scale; floats as they are, what overshoots clipped."""
    if array.dtype in (np.uint8, np.uint16):
        return in_unit_range(array, str(path))
    if array.dtype.kind != "f":
        raise FactoryError(f"{path}: {array.dtype} pixels; give uint8, uint16 or floats in 0..1")
    low, high = float(array.min(initial=0)), float(array.max(initial=0))
    if not -0.5 <= low <= high <= 1.5:
        raise FactoryError(f"{path}: pixels of {low:g} .. {high:g}; floats must lie in 0..1")
    return np.asarray(np.clip(array, 0, 1), np.float32)


def _checked(given: PicturesFolder, items: Sequence[Item]) -> str:
    """Changes with the files.  Looks at the size of each without decoding it."""
    folder = Path(given.dir).expanduser()
    where = f"pictures: {given.name}: {folder}"
    if not folder.is_dir():
        raise FactoryError(f"{where}: no such folder")
    files = [_file_of(folder, item) for item in items]
    lacking = [item for item, file in zip(items, files, strict=True) if file is None]
    if lacking:
        raise FactoryError(
            f"{where}: {len(lacking)} of {len(items)} pictures are missing, the first is "
            f"{_names(lacking[0])[0]}.png (or .npy); names are those of `simnfnd export --to png` "
            "and of `simnfnd denoise`"
        )
    digest = hashlib.blake2b(digest_size=12)
    for item, file in zip(items, files, strict=True):
        assert file is not None
        shape, wanted = _shape(file), _pair_shape(item.place[0], item.place[1] < 0)
        if shape != wanted:
            raise FactoryError(
                f"{where}: {file.name} has {_size(shape)} pixels, but its pair has {_size(wanted)}"
            )
        found = file.stat()
        digest.update(f"{file} {found.st_size} {found.st_mtime_ns}\n".encode())
    return digest.hexdigest()


def _names(item: Item) -> list[str]:
    """Where a picture may lie, without its suffix: as `export --to png` and `denoise` name it."""
    if item.place[1] < 0:
        stem = Path(item.place[0]).stem
        return [stem, f"noisy/{stem}"]
    number = f"{item.number:06d}"
    return [f"{item.split}/noisy/{number}", f"{item.split}/{number}", f"noisy/{number}", number]


def _file_of(folder: Path, item: Item) -> Path | None:
    folder = folder.expanduser()
    for name in _names(item):
        for suffix in SUFFIXES:
            path = folder / f"{name}{suffix}"
            if path.is_file():
                return path
    return None


@lru_cache(maxsize=4096)
def _pair_shape(path: str, is_picture: bool) -> tuple[int, ...]:
    if is_picture:
        return _shape(Path(path))
    with reading(Path(path)) as file:
        return tuple(file["noisy"].shape[1:])


def _shape(path: Path) -> tuple[int, ...]:
    """(H, W) of a picture or an array."""
    try:
        if path.suffix == ".npy":
            array = np.load(path, mmap_mode="r", allow_pickle=False)
            return tuple(array.shape)
        with Image.open(path) as opened:
            return opened.height, opened.width
    except (OSError, ValueError) as error:
        raise FactoryError(f"{path}: not a readable picture ({error})") from error


def _size(shape: tuple[int, ...]) -> str:
    return "x".join(map(str, reversed(shape)))
