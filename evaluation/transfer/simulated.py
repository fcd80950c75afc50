"""The labelled images of a dataset that `simnfnd make` made, as a detector learns from them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ...factory.common.array_types import Float32s, Int64s
from ...factory.common.errors import FactoryError
from ...factory.dataset.labels import classes_of
from ...factory.dataset.pair_dataset import PairDataset
from ...factory.dataset.reader import Split
from ...factory.dataset.schema import stored_image
from ...factory.production.export.objects import MIN_OBJECT_PX, has_labels
from ...models.detection.boxes import grow_boxes, no_boxes
from ...models.detection.images import LabelledImage, WorkingImage, scale_image

_LAYERS = ("noisy", "segmentation", "instance")


def simulated_classes(folder: str | Path) -> tuple[str, ...]:
    """The names of the classes that a dataset may hold, without the background.

    Raises FactoryError for a dataset without labels.
    """
    with PairDataset(folder, "train", layers=None) as pairs:
        if not has_labels(pairs):
            raise FactoryError(
                f"dataset={folder}: has no labels; make it with dataset.layers=[segmentation]"
            )
        return classes_of(pairs.form.config)[1:]


def read_simulated(
    folder: str | Path, classes: Sequence[str], *, padding: float, limit: int | None = None
) -> tuple[list[WorkingImage], list[WorkingImage]]:
    """The images of the training split with labels, and those of the test split.

    classes: those to find, in the order of their labels; other objects are background.
    padding: boxes are grown on every side by this share of the longer side of the image, because
    people draw boxes wider than the echoes of the object.
    limit: of the images of each split, evenly thinned.
    Raises FactoryError for a dataset that shows no object of `classes`.
    """
    with PairDataset(folder, "all", layers=None) as pairs:
        has_test = "test" in pairs.splits
    learned = _read_split(folder, "train", classes, padding, limit)
    held_out = _read_split(folder, "test", classes, padding, limit) if has_test else []
    if not any(len(working.labelled.boxes) for working in learned):
        raise FactoryError(f"dataset={folder}: shows none of the classes {', '.join(classes)}")
    return learned, held_out


def _read_split(
    folder: str | Path, split: Split, classes: Sequence[str], padding: float, limit: int | None
) -> list[WorkingImage]:
    with PairDataset(folder, split, layers=_LAYERS, trusted=True) as pairs:
        return _read_images(pairs, classes, padding, limit)


def _read_images(
    pairs: PairDataset, classes: Sequence[str], padding: float, limit: int | None
) -> list[WorkingImage]:
    known = classes_of(pairs.form.config)
    # Number in the image -> label of the detector; -1: background.
    label_of = np.array([classes.index(n) if n in classes else -1 for n in known], np.int64)
    step = 1 if limit is None else max(1, len(pairs) // limit)
    numbers = range(0, len(pairs), step)[:limit]
    images = []
    for number in numbers:
        sample = pairs[number]
        boxes, labels = _objects_in(sample["instance"], sample["segmentation"], label_of)
        image = np.asarray(stored_image(sample["noisy"], "uint8"), np.uint8)
        grown = grow_boxes(boxes, padding * max(image.shape), *image.shape)
        name = f"{pairs.split}-{number:06d}"
        images.append(scale_image(LabelledImage(name, name, image, grown, labels)))
    return images


def _objects_in(
    instance: npt.NDArray[np.integer],
    segmentation: npt.NDArray[np.integer],
    label_of: Int64s,
) -> tuple[Float32s, Int64s]:
    """Boxes and labels of the objects of an image that are to be found."""
    boxes = []
    labels = []
    for number, place in enumerate(ndimage.find_objects(instance.astype(np.int32)), start=1):
        if place is None:
            continue
        is_object = instance[place] == number
        label = label_of[np.bincount(segmentation[place][is_object]).argmax()]
        if label < 0 or is_object.sum() < MIN_OBJECT_PX:
            continue
        rows, columns = place
        boxes.append([columns.start, rows.start, columns.stop, rows.stop])
        labels.append(label)
    if not boxes:
        return no_boxes(), np.zeros(0, np.int64)
    return np.array(boxes, np.float32), np.array(labels, np.int64)
