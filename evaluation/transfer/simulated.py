"""The labelled images of a dataset that `simnfnd make` made, as a detector learns from them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from ...factory.common.array_types import Int64s
from ...factory.common.errors import FactoryError
from ...factory.dataset.fan_geometry import FanGeometry, recorded_sonar
from ...factory.dataset.labels import classes_of
from ...factory.dataset.pair_dataset import PairDataset
from ...factory.dataset.reader import Split
from ...factory.dataset.schema import stored_image
from ...factory.production.export.object_boxes import Box, box_with_shadow, parse_places
from ...factory.production.export.objects import MIN_OBJECT_PX, has_labels
from ...models.detection.boxes import grow_boxes
from ...models.detection.images import LabelledImage, WorkingImage, scale_image

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
    """

    padding: float = 0.0
    with_shadow: tuple[str, ...] = ()
    min_visibility_db: float | None = None
    min_side: float = 0.0


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
    known = classes_of(pairs.form.config)
    # Number in the image -> label of the detector; -1: background.
    label_of = np.array([classes.index(n) if n in classes else -1 for n in known], np.int64)
    step = 1 if limit is None else max(1, len(pairs) // limit)
    numbers = range(0, len(pairs), step)[:limit]
    shadow_labels = {n for n, name in enumerate(classes) if name in rules.with_shadow}
    records = pairs.meta()
    images = []
    for number in numbers:
        sample = pairs[number]
        image = np.asarray(stored_image(sample["noisy"], "uint8"), np.uint8)
        longer_px = max(image.shape)
        objects = [
            shown
            for shown in _objects_in(sample["instance"], sample["segmentation"], label_of)
            if min(shown.box.width, shown.box.height) >= rules.min_side * longer_px
        ]
        objects = _visible(objects, records[number], rules.min_visibility_db)
        if any(shown.label in shadow_labels for shown in objects):
            objects = _with_shadows(objects, shadow_labels, pairs, records[number])
        boxes = np.array([shown.box.corners for shown in objects], np.float32).reshape(-1, 4)
        labels = np.array([shown.label for shown in objects], np.int64)
        grown = grow_boxes(boxes, rules.padding * longer_px, *image.shape)
        name = f"{pairs.split}-{number:06d}"
        images.append(scale_image(LabelledImage(name, name, image, grown, labels)))
    return images


@dataclass(frozen=True)
class _SimulatedObject:
    """An object in a simulated image.

    number: its number in /instance.  label: number of its class.
    box: around its echoes, or its echoes and shadow.
    """

    number: int
    label: int
    box: Box


def _objects_in(
    instance: npt.NDArray[np.integer],
    segmentation: npt.NDArray[np.integer],
    label_of: Int64s,
) -> Iterator[_SimulatedObject]:
    """The objects of an image that are to be found."""
    for number, place in enumerate(ndimage.find_objects(instance.astype(np.int32)), start=1):
        if place is None:
            continue
        is_object = instance[place] == number
        label = int(label_of[np.bincount(segmentation[place][is_object]).argmax()])
        if label < 0 or is_object.sum() < MIN_OBJECT_PX:
            continue
        rows, columns = place
        width = columns.stop - columns.start
        box = Box(columns.start, rows.start, width, rows.stop - rows.start)
        yield _SimulatedObject(number, label, box)


def _visible(
    objects: list[_SimulatedObject], record: np.void, least_db: float | None
) -> list[_SimulatedObject]:
    """Objects that stand out by so much; all objects where the dataset does not say."""
    if least_db is None or "visibility" not in (record.dtype.names or ()):
        return objects
    visibility_db = json.loads(record["visibility"].decode())
    return [shown for shown in objects if visibility_db.get(str(shown.number), 0.0) >= least_db]


def _with_shadows(
    objects: list[_SimulatedObject], labels: set[int], pairs: PairDataset, record: np.void
) -> list[_SimulatedObject]:
    """The same objects, those of some labels with boxes around echoes and shadow."""
    sonar = recorded_sonar(pairs.form.config)
    if sonar is None:
        raise FactoryError(f"with_shadow: the device of {pairs.folder} is not known; leave it out")
    plain: dict[str, Any] = {name: record[name].item() for name in record.dtype.names or ()}
    places = parse_places(plain["boxes"].decode(), f"{pairs.folder}")
    geometry = FanGeometry.from_record(sonar, plain)
    height, width = pairs.shape
    extended = []
    for shown in objects:
        if shown.label in labels and shown.number in places:
            box = box_with_shadow(shown.box, places[shown.number], geometry, (height, width))
            shown = replace(shown, box=box)
        extended.append(shown)
    return extended
