"""Pictures with the objects in them, of datasets with labels and of folders as MDD has them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from PIL import Image

from ..dataset.format.schema import SPLITS, stored_image
from ..dataset.read.reader import Split
from ..dataset.read.source import Source
from ..errors import FactoryError
from ..labels import CLASSES
from .mdd import MDD_CLASSES
from .pictures import png, write_notes, write_text

LEAST_PX = 8
"""An object that shows in fewer pixels is no larger than a speckle, and is left out."""

Picture = npt.NDArray[np.uint8]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Shown:
    """An object in a picture: its class, 1 or more, and the pixels (H, W) where it is seen."""

    label: int
    mask: Mask

    @property
    def box(self) -> tuple[int, int, int, int]:
        """Left, top, width and height in pixels; the box holds the pixels wholly."""
        left, top, width, height = cv2.boundingRect(self.mask.astype(np.uint8))
        return left, top, width, height


@dataclass(frozen=True, eq=False)
class Labelled:
    """A picture, how it looks without noise where that is known, and the objects in it.

    left_out: how many objects are too small.
    """

    key: str
    noisy: Picture
    clean: Picture | None
    objects: tuple[Shown, ...]
    left_out: int


@dataclass(frozen=True)
class LabelledSet:
    """Pictures with objects, to export.

    splits: names of those that have pictures.  pictures: split -> its pictures, one at a time.
    classes: names of the labels 0 (no object), 1, 2, ...
    note: writes README.md into a folder, given what its files are.
    """

    splits: tuple[str, ...]
    pictures: Callable[[str], Iterator[Labelled]]
    classes: tuple[str, ...]
    note: Callable[[Path, str], None]


def labelled_dataset(source: Source, to: str) -> LabelledSet:
    """Of a dataset.  Raises FactoryError when it has no labels."""
    if not {"segmentation", "instance"} <= set(source.layers):
        raise FactoryError(
            f"--to {to}: {source.directory} has no labels (/segmentation and /instance); make it "
            "from procedural scenes with dataset.layers=[segmentation], or export with --to png"
        )

    def pictures(split: str) -> Iterator[Labelled]:
        for sample in source.samples(split):
            noisy, clean = (
                np.asarray(stored_image(sample.images[name], "uint8"), np.uint8)
                for name in ("noisy", "clean")
            )
            masks = instances(sample.images["instance"], sample.images["segmentation"])
            try:
                yield _labelled(sample.key, noisy, clean, masks)
            except FactoryError as error:
                raise FactoryError(f"{source.directory}: {sample.key}: {error}") from error

    def note(folder: Path, reading: str) -> None:
        write_notes(source, folder, reading)

    return LabelledSet(tuple(source.splits), pictures, CLASSES, note)


def instances(
    numbers: npt.NDArray[np.uint16], labels: npt.NDArray[np.uint8]
) -> Iterator[tuple[int, Mask]]:
    """(label, mask) of every object: the pixels of one number, by the label that most have.

    Raises FactoryError for a label that is none.
    """
    for number in np.unique(numbers[numbers > 0]):
        mask = numbers == number
        label = int(np.bincount(labels[mask]).argmax())
        if label >= len(CLASSES):
            raise FactoryError(f"/segmentation has a value {label}, which names no class")
        if label:
            yield label, mask


def is_mdd(folder: Path) -> bool:
    """Whether a folder holds pictures and masks as the Marine Debris Dataset does."""
    return (folder / "Images").is_dir() and (folder / "Masks").is_dir()


def labelled_mdd(folder: Path, split: Split) -> LabelledSet:
    """Of a folder with Images/ and Masks/: an object is a patch of one class.

    train.txt and test.txt, if there, name the pictures of the splits; without them all train.
    Raises FactoryError when there are no pictures or a list names others.
    """
    files = {path.stem: path for path in sorted((folder / "Images").glob("*.png"))}
    splits = {name: keys for name, keys in _mdd_splits(folder, files).items() if keys}
    if split != "all":
        splits = {name: keys for name, keys in splits.items() if name == split}
    if not splits:
        raise FactoryError(f"{folder}: has no split {split}")

    def pictures(name: str) -> Iterator[Labelled]:
        for key in splits[name]:
            noisy, labels = _grey(files[key]), _grey(folder / "Masks" / f"{key}.png")
            if noisy.shape != labels.shape or labels.max() >= len(MDD_CLASSES):
                raise FactoryError(
                    f"{folder / 'Masks' / key}.png: is no mask of {files[key].name} (one class, "
                    f"0 to {len(MDD_CLASSES) - 1}, for each of its pixels)"
                )
            yield _labelled(key, noisy, None, patches(labels))

    def note(out: Path, reading: str) -> None:
        text = f"{sum(map(len, splits.values()))} pictures with masks, as in the Marine Debris "
        text += "Dataset, exported by SimNFND. An object is a patch of pixels of one class."
        write_text(out, folder.resolve().name, text, reading, "That of the pictures.")

    return LabelledSet(tuple(splits), pictures, MDD_CLASSES, note)


def patches(labels: npt.NDArray[np.uint8]) -> Iterator[tuple[int, Mask]]:
    """(label, mask) of every patch of one class, pixels that touch at a corner taken together."""
    for label in np.unique(labels[labels > 0]):
        count, numbers = cv2.connectedComponents((labels == label).astype(np.uint8))
        for number in range(1, count):
            yield int(label), numbers == number


def write_pictures(picture: Labelled, split: str, folder: Path) -> None:
    """images/SPLIT/KEY.png, and clean/SPLIT/KEY.png where there is one."""
    for name, image in (("images", picture.noisy), ("clean", picture.clean)):
        if image is not None:
            path = folder / name / split / f"{picture.key}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(png(image))


def summary(pictures: int, objects: int, left_out: int) -> str:
    """One line that says what was written."""
    return f"{pictures} pictures, {objects} objects; {left_out} below {LEAST_PX} pixels left out"


def _labelled(
    key: str, noisy: Picture, clean: Picture | None, masks: Iterator[tuple[int, Mask]]
) -> Labelled:
    objects = [Shown(label, mask) for label, mask in masks]
    large = tuple(shown for shown in objects if int(shown.mask.sum()) >= LEAST_PX)
    return Labelled(key, noisy, clean, large, len(objects) - len(large))


def _mdd_splits(folder: Path, files: Mapping[str, Path]) -> dict[str, list[str]]:
    lists = {split: folder / f"{split}.txt" for split in SPLITS}
    if not any(path.is_file() for path in lists.values()):
        return {"train": list(files)}
    found: dict[str, list[str]] = {}
    for split, path in lists.items():
        try:
            lines = path.read_text(encoding="utf-8").split() if path.is_file() else []
        except (OSError, UnicodeDecodeError) as error:
            raise FactoryError(f"{path}: not a readable list of names") from error
        keys = [line.removesuffix(".png") for line in lines]
        absent = [key for key in keys if key not in files]
        if absent:
            raise FactoryError(f"{path}: names {absent[0]!r}, which is not in Images")
        found[split] = list(dict.fromkeys(keys))
    return found


def _grey(path: Path) -> Picture:
    """(H, W) uint8 of a picture file."""
    if not path.is_file():
        raise FactoryError(f"{path}: no such file; every picture needs its mask")
    try:
        with Image.open(path, formats=["PNG"]) as one:
            picture, mode = np.asarray(one), one.mode
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise FactoryError(f"{path}: not a readable PNG ({error})") from error
    if mode != "L":
        raise FactoryError(f"{path}: is a picture of mode {mode}; expected 8-bit grey (L)")
    return picture
