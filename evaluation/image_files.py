"""Folders of image files as datasets: noisy/ and clean/, perhaps shadow/, with equal file names.

Rules: 8 bits count to 255, 16 bits to 65535, floats lie in 0..1.  A colour image counts when its
channels are equal; transparency is left out.  Both images of a pair have one size; pairs may
differ.  `shadow/` holds masks, any value above 0 is shadow; without it shadow metrics do not exist.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..factory.errors import FactoryError
from ..factory.files import sha256_of
from ..models.recordings import PICTURE_SUFFIXES, SEQUENCES, kind_of
from ..models.recordings.arrays import is_table
from ..models.recordings.pictures import in_unit_range, read_picture
from .filters.base import Gray

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
