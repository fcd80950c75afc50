"""The labelled images of a dataset that `simnfnd make` made, as a detector learns from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...factory.common.array_types import Bools
from ...factory.common.errors import FactoryError
from ...factory.dataset.meaning import classes_of
from ...factory.dataset.pair_dataset import PairDataset
from ...factory.dataset.reader import Split
from ...factory.dataset.schema import stored_image
from ...factory.production.export.object_selection import ObjectSelection
from ...factory.production.export.objects import (
    MIN_OBJECT_PX,
    VisibleObject,
    echo_box,
    has_labels,
    is_clear,
    visible_objects,
)
from ...factory.production.export.samples import ExportedSample, plain_record
from ...models.detection.boxes import grow_boxes
from ...models.detection.images import (
    LabelledImage,
    WorkingImage,
    find_fan,
    reaches_far_end,
    scale_image,
)

_LAYERS = ("noisy", "segmentation", "instance")


@dataclass(frozen=True)
class LabelRules:
    """Which objects of a dataset a detector is taught, and what their boxes are around.

    padding: boxes are grown on every side by this share of the longer side of the image, because
        people draw boxes wider than the echoes of the object.
    with_shadow: classes whose boxes hold the shadow, too, as people draw them around thin things
        that stand.
    min_visibility_db: fainter objects are not taught, where the dataset says how visible they are.
    min_side: nor are those whose echoes are narrower than this share of the longer side.
    far_end: whether objects are taught that the far end of the range window cuts off.
    """

    padding: float = 0.0
    with_shadow: tuple[str, ...] = ()
    min_visibility_db: float | None = None
    min_side: float = 0.0
    far_end: bool = True


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
    folder: str | Path, classes: Sequence[str], rules: LabelRules, *, limit: int | None = None
) -> tuple[list[WorkingImage], list[WorkingImage]]:
    """The images of the training split with labels, and those of the test split.

    classes: those to find, in the order of their labels; other objects are background.
    limit: of the images of each split, evenly thinned.
    Raises FactoryError for a dataset that shows no object of `classes`, or that does not say where
    shadows end that the rules ask for.
    """
    with PairDataset(folder, "all", layers=None) as pairs:
        has_test = "test" in pairs.splits
        columns = {column.name for column in pairs.form.columns}
    if rules.with_shadow and "boxes" not in columns:
        raise FactoryError(
            f"with_shadow: {folder} does not say where shadows end; make it with "
            "dataset.columns=[boxes]"
        )
    learned = _read_split(folder, "train", classes, rules, limit)
    held_out = _read_split(folder, "test", classes, rules, limit) if has_test else []
    if not any(len(working.labelled.boxes) for working in learned):
        raise FactoryError(f"dataset={folder}: shows none of the classes {', '.join(classes)}")
    return learned, held_out


def _read_split(
    folder: str | Path, split: Split, classes: Sequence[str], rules: LabelRules, limit: int | None
) -> list[WorkingImage]:
    with PairDataset(folder, split, layers=_LAYERS, trusted=True) as pairs:
        return _read_images(pairs, classes, rules, limit)


def _read_images(
    pairs: PairDataset, classes: Sequence[str], rules: LabelRules, limit: int | None
) -> list[WorkingImage]:
    step = 1 if limit is None else max(1, len(pairs) // limit)
    numbers = range(0, len(pairs), step)[:limit]
    records = pairs.meta()
    images = []
    for number in numbers:
        sample = ExportedSample(pairs.split, number, pairs[number], plain_record(records[number]))
        image = np.asarray(stored_image(sample.images["noisy"], "uint8"), np.uint8)
        objects = list(_taught_objects(sample, pairs, classes, rules, find_fan(image)))
        boxes = np.array([shown.box.corners for shown in objects], np.float32).reshape(-1, 4)
        labels = np.array([classes.index(shown.class_name) for shown in objects], np.int64)
        grown = grow_boxes(boxes, rules.padding * max(image.shape), *image.shape)
        images.append(scale_image(LabelledImage(sample.key, sample.key, image, grown, labels)))
    return images


def _taught_objects(
    sample: ExportedSample,
    pairs: PairDataset,
    classes: Sequence[str],
    rules: LabelRules,
    is_fan: Bools,
) -> Iterator[VisibleObject]:
    """The objects of an image that a detector is to find."""
    selection = ObjectSelection(min_visibility_db=rules.min_visibility_db)
    box_of = dict.fromkeys(rules.with_shadow, "echo+shadow")
    least_px = rules.min_side * max(is_fan.shape)
    for shown in visible_objects(sample, pairs, selection, box_of):
        echo = echo_box(shown.mask)
        if shown.class_name not in classes or shown.area_px < MIN_OBJECT_PX:
            continue
        if not is_clear(shown, selection) or min(echo.width, echo.height) < least_px:
            continue
        corners = np.array([echo.corners], np.float32)
        if rules.far_end or not reaches_far_end(corners, is_fan)[0]:
            yield shown
