"""Labelled pictures: a folder of real ones with masks, and what the factory drew."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.dataset.read.pair_dataset import PairDataset
from ...factory.dataset.read.reader import Split
from ...factory.errors import FactoryError
from ...factory.labels import CLASSES
from ...factory.sonar.geometry import FanGeometry
from ...models.recordings.fan.finder import find_geometry
from ..data.pairs import geometry_of
from ..filters.base import Gray
from ..methods.apply import denoised
from ..methods.method import Method
from ..real.shots import open_input

Mask = npt.NDArray[np.uint8]
Indices = npt.NDArray[np.int64]

WALL = CLASSES.index("Wall")
"""Neither an object nor ground: what is told of objects leaves its pixels out."""
LEAST_CLASSES = WALL + 1
"""Those of the Marine Debris Dataset."""


@dataclass(frozen=True, eq=False)
class Labelled:
    """Pictures of one size with the class of each pixel.

    images: (H, W) float32 in 0..1 each.  masks: (H, W) uint8 class indices.
    geometries: where range and bearing are, None where nothing says it.
    """

    names: tuple[str, ...]
    images: tuple[Gray, ...]
    masks: tuple[Mask, ...]
    geometries: tuple[FanGeometry | None, ...]

    @property
    def digest(self) -> str:
        """Changes with the pictures and their masks."""
        content = hashlib.blake2b(digest_size=12)
        for name, image, mask in zip(self.names, self.images, self.masks, strict=True):
            content.update(name.encode())
            content.update(np.ascontiguousarray(image).tobytes())
            content.update(np.ascontiguousarray(mask).tobytes())
        return content.hexdigest()


def read_real(folder: str) -> Labelled:
    """Pictures with masks of their names in Masks/, as the Marine Debris Dataset has them.

    Raises FactoryError for a picture without a mask, one that cannot be read, a class that there
    is not, and pictures of several sizes.
    """
    shots = [shot for stretch in open_input(folder, 10**9)[0] for shot in stretch.shots]
    found: list[tuple[str, Gray, Mask, FanGeometry | None]] = []
    for shot in shots:
        if shot.mask is None:
            raise FactoryError(f"real: {shot.path} has no mask of its name in Masks/")
        picture, geometry = shot.read()
        mask = shot.classes()
        if mask.max() >= len(CLASSES):
            raise FactoryError(
                f"{shot.mask}: class {mask.max()}; classes are 0 to {len(CLASSES) - 1} "
                "(docs/dataset.md), save the mask with these"
            )
        if found and picture.shape != found[0][1].shape:
            raise FactoryError(
                f"real: {shot.path} is {_size(picture)}, {shots[0].path} {_size(found[0][1])}; "
                "give pictures of one size"
            )
        found.append((shot.name, picture, mask, geometry or find_geometry(picture)))
    return Labelled(*zip(*found, strict=True))


def read_simulated(folder: str, shape: tuple[int, int]) -> Labelled:
    """All noisy pictures of a dataset that was made with labels; they are to have that shape.

    Raises FactoryError when they have another, and for a dataset without labels.
    """
    root = Path(folder).expanduser()
    found: list[tuple[str, Gray, Mask, FanGeometry | None]] = []
    both: tuple[Split, ...] = ("train", "test")
    splits = [split for split in both if any(root.glob(f"{split}/shard-*.h5"))]
    if not splits:
        raise FactoryError(f"sim={folder}: no dataset there; give one that `simnfnd make` made")
    for split in splits:
        layers = ("noisy", "segmentation")
        with PairDataset(root, split, layers=layers, scaled=True) as pairs:
            if pairs.shape != shape:
                raise FactoryError(
                    f"sim={folder}: its pictures are {pairs.shape[1]}x{pairs.shape[0]}, the real "
                    f"ones {shape[1]}x{shape[0]}; make them with sonar.image.width_px={shape[1]} "
                    f"sonar.image.height_px={shape[0]}"
                )
            for number in range(len(pairs)):
                sample, (path, row) = pairs[number], pairs.place(number)
                place = (str(path), row)
                name = f"{split}/{path.name}[{row}]"
                mask = np.asarray(sample["segmentation"], np.uint8)
                found.append((name, sample["noisy"], mask, geometry_of(place)))
    return Labelled(*zip(*found, strict=True))


def denoised_by(method: Method, pictures: Labelled, device: str) -> list[Gray]:
    """What a method makes of the pictures.  FactoryError when it fails on one."""
    found = []
    for name, image, geometry in zip(
        pictures.names, pictures.images, pictures.geometries, strict=True
    ):
        try:
            found.append(denoised(method, image, device, None, geometry))
        except (ValueError, ArithmeticError) as error:
            raise FactoryError(f"{method.label} fails on {name}: {error}") from error
    return found


def inputs_of(images: Sequence[Gray], shrink: int) -> npt.NDArray[np.float32]:
    """(N, H // shrink, W // shrink): areas averaged, each over the mean of its lit pixels, less 1.

    So no network can tell methods or sonars by their brightness.
    """
    height, width = (max(size // shrink, 1) for size in images[0].shape)
    found = np.empty((len(images), height, width), np.float32)
    for small, image in zip(found, images, strict=True):
        small[:] = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
        lit = small[small > 0]
        small /= lit.mean() if lit.size else 1
    return found - 1


def targets_of(masks: Sequence[Mask], shrink: int, classes: int) -> Indices:
    """(N, H // shrink, W // shrink) class indices; those from `classes` on become ground."""
    height, width = (max(size // shrink, 1) for size in masks[0].shape)
    how = cv2.INTER_NEAREST
    small = np.stack([cv2.resize(mask, (width, height), interpolation=how) for mask in masks])
    return np.where(small < classes, small, 0).astype(np.int64)


def _size(picture: Gray) -> str:
    return f"{picture.shape[1]}x{picture.shape[0]}"
