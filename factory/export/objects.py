"""The objects in the pictures of a dataset with labels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from ..dataset.schema import stored_image
from ..dataset.source import Sample, Source
from ..errors import FactoryError
from ..labels import classes_of
from .pictures import png

LEAST_PX = 8
"""An object that shows in fewer pixels is no larger than a speckle, and is left out."""

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


class Objects:
    """The pictures of a dataset and their objects, on their way to `folder`.

    Raises FactoryError for a dataset without labels.
    """

    def __init__(self, source: Source, to: str, folder: Path) -> None:
        if not {"segmentation", "instance"} <= set(source.layers):
            raise FactoryError(
                f"--to {to}: {source.directory} has no labels (/segmentation and /instance); make "
                "it from scenes with labels and dataset.layers=[segmentation], or export with "
                "--to png"
            )
        self._source, self._folder = source, folder
        self.classes = classes_of(source.config)
        self._pictures = self._objects = self._left_out = 0

    def of(self, split: str) -> Iterator[tuple[str, list[Shown]]]:
        """(key, objects) of every sample, whose images/SPLIT/KEY.png and clean/ are written."""
        for sample in self._source.samples(split):
            for name, layer in (("images", "noisy"), ("clean", "clean")):
                path = self._folder / name / split / f"{sample.key}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(png(stored_image(sample.images[layer], "uint8")))
            found = list(shown_in(sample, self.classes, self._source.directory))
            large = [shown for shown in found if int(shown.mask.sum()) >= LEAST_PX]
            self._pictures += 1
            self._objects += len(large)
            self._left_out += len(found) - len(large)
            yield sample.key, large

    def summary(self) -> str:
        """One line that says what was written."""
        return (
            f"{self._pictures} pictures, {self._objects} objects; {self._left_out} below "
            f"{LEAST_PX} pixels left out"
        )


def shown_in(sample: Sample, classes: tuple[str, ...], directory: Path) -> Iterator[Shown]:
    """The pixels of each number in /instance, by the label that most of them have."""
    numbers, labels = sample.images["instance"], sample.images["segmentation"]
    for number in np.unique(numbers[numbers > 0]):
        mask = numbers == number
        label = int(np.bincount(labels[mask]).argmax())
        if label >= len(classes):
            raise FactoryError(
                f"{directory}: {sample.key}: /segmentation has a value {label}, "
                "which names no class"
            )
        if label:
            yield Shown(label, mask)
