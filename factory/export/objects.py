"""Labelled objects in the images of a dataset, for detectors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from ..dataset.pair_dataset import PairDataset
from ..dataset.schema import stored_image
from ..errors import FactoryError
from ..labels import classes_of
from .png_encoding import encode_png
from .samples import Sample, read_samples

MIN_OBJECT_PX = 8
"""An object that shows in fewer pixels is no larger than a speckle, and is left out."""


class Box(NamedTuple):
    """The smallest box around an object, pixels."""

    left: int
    top: int
    width: int
    height: int


@dataclass(frozen=True, eq=False)
class VisibleObject:
    """An object in an image: its class, 1 or more, and the pixels (H, W) that show it."""

    label: int
    mask: npt.NDArray[np.bool_]

    @cached_property
    def area_px(self) -> int:
        """The number of pixels that show it."""
        return int(self.mask.sum())

    @property
    def box(self) -> Box:
        """The box around the pixels of the mask."""
        return Box(*cv2.boundingRect(self.mask.astype(np.uint8)))


class LabelledImage(NamedTuple):
    """An image of an export for detectors.

    key: name of its files.  objects: those of MIN_OBJECT_PX and more pixels.
    small_count: number of objects that were left out.
    """

    key: str
    objects: list[VisibleObject]
    small_count: int


def has_labels(pairs: PairDataset) -> bool:
    """Whether the dataset says which object a pixel shows, and of which class it is."""
    return {"segmentation", "instance"} <= set(pairs.layers)


def visible_objects(sample: Sample, pairs: PairDataset) -> Iterator[VisibleObject]:
    """The pixels of each number in /instance, with the label that most of them have.

    Raises FactoryError for a label that names no class of the dataset.
    """
    classes = classes_of(pairs.form.config)
    object_numbers = sample.images["instance"]
    labels = sample.images["segmentation"]
    for object_number in np.unique(object_numbers[object_numbers > 0]):
        mask = object_numbers == object_number
        label = int(np.bincount(labels[mask]).argmax())
        if label >= len(classes):
            raise FactoryError(
                f"{pairs.folder}: {sample.key}: /segmentation has a value {label}, "
                "which names no class"
            )
        if label:
            yield VisibleObject(label, mask)


def write_labelled_images(pairs: PairDataset, folder: Path, split: str) -> Iterator[LabelledImage]:
    """Write images/SPLIT/KEY.png (noisy) and clean/SPLIT/KEY.png, uint8, and yield their objects.

    Raises FactoryError for a dataset without labels, or with a label that names no class.
    """
    if not has_labels(pairs):
        raise FactoryError(
            f"{pairs.folder} has no labels (/segmentation and /instance); make it from scenes with "
            "labels and dataset.layers=[segmentation], or export with --to png"
        )
    for sample in read_samples(pairs, split):
        _write_image(sample, "noisy", folder / "images" / split)
        _write_image(sample, "clean", folder / "clean" / split)

        every_object = list(visible_objects(sample, pairs))
        large_objects = [shown for shown in every_object if shown.area_px >= MIN_OBJECT_PX]
        small_count = len(every_object) - len(large_objects)
        yield LabelledImage(sample.key, large_objects, small_count)


def _write_image(sample: Sample, layer: str, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    image = stored_image(sample.images[layer], "uint8")
    (folder / f"{sample.key}.png").write_bytes(encode_png(image))


def summarize_objects(pairs: PairDataset, object_count: int, small_count: int) -> str:
    """What an export says of its images and objects."""
    return (
        f"{len(pairs)} images, {object_count} objects; "
        f"{small_count} below {MIN_OBJECT_PX} pixels left out"
    )
