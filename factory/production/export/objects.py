"""Labelled objects in the images of a dataset, for detectors."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from ...common.array_types import Array, Bools
from ...common.errors import FactoryError
from ...dataset.fan_geometry import FanGeometry, recorded_sonar
from ...dataset.meaning import classes_of
from ...dataset.pair_dataset import PairDataset
from ...dataset.schema import stored_image
from .object_boxes import Box, ObjectPlace, box_of_object, box_with_shadow, parse_places
from .object_selection import ClassList, ObjectSelection
from .png import encode_png
from .samples import ExportedSample, read_samples

MIN_OBJECT_PX = 8
"""An object that shows in fewer pixels is no larger than a speckle, and is left out."""

MIN_SIDE_PX = 2
"""Ultralytics leaves out narrower boxes when it trains."""


@dataclass(frozen=True, eq=False)
class VisibleObject:
    """An object in an image: the name of its class, and the pixels (H, W) that show it.

    box: by the convention of the export.  visibility_db: None where the dataset does not say.
    """

    class_name: str
    mask: Bools
    box: Box
    visibility_db: float | None = None

    @cached_property
    def area_px(self) -> int:
        """The number of pixels that show it."""
        return int(self.mask.sum())

    @property
    def is_echo_box(self) -> bool:
        """Whether the box is that around the mask."""
        return self.box == echo_box(self.mask)


def echo_box(mask: Bools) -> Box:
    """The box around the pixels of a mask."""
    return Box(*cv2.boundingRect(mask.astype(np.uint8)))


class ExportedImage(NamedTuple):
    """An image of an export for detectors: the name of its files, and the objects it shows."""

    key: str
    objects: list[VisibleObject]


@dataclass(frozen=True, eq=False)
class ExportedObjects:
    """The objects of an export: their classes, smallest size, and how many there are.

    min_side_px: smallest width and height of a box, pixels.
    counts: class -> number of objects.  small_count: number of objects that were left out.
    selection: what the user asks for.
    """

    classes: ClassList
    min_side_px: int
    counts: Mapping[str, int]
    small_count: int
    selection: ObjectSelection

    def has_room_for(self, shown: VisibleObject) -> bool:
        """Whether an object is of a class of the export, and large enough."""
        if shown.class_name not in self.classes or not is_large(shown, self.min_side_px):
            return False
        return is_clear(shown, self.selection)

    def summarize(self, image_count: int) -> str:
        """What an export says of its images and objects."""
        object_count = sum(self.counts.values())
        return (
            f"{image_count} images, {object_count} objects of {len(self.classes.names)} classes; "
            f"{self.small_count} {self.describe_limit()} left out"
        )

    def describe_limit(self) -> str:
        """Which objects are too small."""
        limit = f"below {MIN_OBJECT_PX} pixels or narrower than {self.min_side_px}"
        if self.selection.min_visibility_db is None:
            return limit
        return f"fainter than {self.selection.min_visibility_db:g} dB, {limit}"

    def describe(self, first_number: int = 1) -> str:
        """The classes, their numbers and the limit of size, as a paragraph for a README."""
        counts = ", ".join(f"{self.counts.get(name, 0)} {name}" for name in self.classes.names)
        return (
            f"Classes: {self.classes.describe(first_number)}. Objects: {counts}. "
            f"{self.small_count} objects {self.describe_limit()} pixels (width or height of the "
            f"box) are left out. {self.selection.describe_boxes()}"
        )


def has_labels(pairs: PairDataset) -> bool:
    """Whether the dataset says which object a pixel shows, and of which class it is."""
    return {"segmentation", "instance"} <= set(pairs.layers)


def is_large(shown: VisibleObject, min_side_px: int) -> bool:
    """Whether an object shows in enough pixels, and its box is wide and high enough."""
    if shown.area_px < MIN_OBJECT_PX:
        return False
    return min(shown.box.width, shown.box.height) >= min_side_px


def is_clear(shown: VisibleObject, selection: ObjectSelection) -> bool:
    """Whether an object stands out as much as the selection asks for."""
    if selection.min_visibility_db is None or shown.visibility_db is None:
        return True
    return shown.visibility_db >= selection.min_visibility_db


def survey_objects(pairs: PairDataset, selection: ObjectSelection) -> ExportedObjects:
    """Read the labels of all samples, and choose and count the objects of an export.

    Raises FactoryError for a dataset without labels, a label that names no class, and classes of
    the selection that the dataset does not know.
    """
    if not has_labels(pairs):
        raise FactoryError(
            f"{pairs.folder} has no labels (/segmentation and /instance); make it from scenes with "
            "labels and dataset.layers=[segmentation], or export with --to png"
        )
    _refuse_missing_columns(pairs, selection)
    min_side_px = selection.min_side_px or MIN_SIDE_PX
    large_counts: Counter[str] = Counter()
    small_counts: Counter[str] = Counter()
    labels = ("segmentation", "instance")
    with PairDataset(pairs.folder, pairs.split, layers=labels, trusted=True) as labelled:
        for split in labelled.splits:
            for sample in read_samples(labelled, split):
                for shown in visible_objects(sample, labelled, selection):
                    has_room = is_large(shown, min_side_px) and is_clear(shown, selection)
                    counts = large_counts if has_room else small_counts
                    counts[shown.class_name] += 1
    classes = selection.list_classes(classes_of(pairs.form.config), large_counts)
    return ExportedObjects(
        classes=classes,
        min_side_px=min_side_px,
        counts={name: large_counts[name] for name in classes.names},
        small_count=sum(
            count
            for name, count in small_counts.items()
            if name in classes or not selection.class_names
        ),
        selection=selection,
    )


def _refuse_missing_columns(pairs: PairDataset, selection: ObjectSelection) -> None:
    """Raise FactoryError where the dataset lacks a column that the selection needs."""
    columns = {column.name for column in pairs.form.columns}
    if selection.min_visibility_db is not None and "visibility" not in columns:
        raise FactoryError(
            f"--min-visibility: {pairs.folder} has no column visibility; make it with "
            "dataset.columns=[visibility]"
        )
    if selection.box != "echo" and "boxes" not in columns:
        raise FactoryError(
            f"--box {selection.box}: {pairs.folder} has no column boxes; make it with "
            "dataset.columns=[boxes]"
        )


def visible_objects(
    sample: ExportedSample,
    pairs: PairDataset,
    selection: ObjectSelection,
    box_of: Mapping[str, str] | None = None,
) -> Iterator[VisibleObject]:
    """The pixels of each number in /instance, with the class that most of them have.

    box_of: class -> what its boxes are around, where it is not what the selection says.
    Raises FactoryError for a label that names no class of the dataset, and for columns that cannot
    be read.
    """
    visibility_db = _visibility_db(sample, pairs)
    boxes = _SampleBoxes(sample, pairs)
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
            number = int(object_number)
            class_name = classes[label]
            convention = (box_of or {}).get(class_name, selection.box)
            box = boxes.around(number, mask, convention)
            yield VisibleObject(class_name, mask, box, visibility_db.get(number))


def _visibility_db(sample: ExportedSample, pairs: PairDataset) -> dict[int, float]:
    """Number in /instance -> visibility, dB; empty where the dataset does not say."""
    text = sample.record.get("visibility")
    if text is None:
        return {}
    try:
        return {int(number): float(value) for number, value in json.loads(str(text)).items()}
    except (AttributeError, TypeError, ValueError) as error:
        raise FactoryError(
            f"{pairs.folder}: {sample.key}: column visibility is no list of numbers; make the "
            "dataset anew"
        ) from error


class _SampleBoxes:
    """The boxes of the objects of one sample, by convention."""

    def __init__(self, sample: ExportedSample, pairs: PairDataset) -> None:
        self._record = sample.record
        self._config = pairs.form.config
        self._name = f"{pairs.folder}: {sample.key}"

    def around(self, number: int, mask: Bools, convention: str) -> Box:
        """The box of an object, whose echoes are the mask."""
        echo = echo_box(mask)
        make_box = _BOX_MAKERS.get(convention)
        if make_box is None or number not in self._places:
            return echo
        height, width = mask.shape
        return make_box(echo, self._places[number], self._geometry, (height, width))

    @cached_property
    def _places(self) -> Mapping[int, ObjectPlace]:
        return parse_places(str(self._record["boxes"]), self._name)

    @cached_property
    def _geometry(self) -> FanGeometry:
        sonar = recorded_sonar(self._config)
        if sonar is None:
            raise FactoryError(
                f"{self._name}: its device is not known; only boxes around echoes can be made "
                "(--box echo)"
            )
        return FanGeometry.from_record(sonar, self._record)


_BOX_MAKERS = {"echo+shadow": box_with_shadow, "object": box_of_object}


def write_labelled_images(
    pairs: PairDataset, folder: Path, split: str, exported: ExportedObjects
) -> Iterator[ExportedImage]:
    """Write images/SPLIT/KEY.png (noisy) and clean/SPLIT/KEY.png, uint8, and yield their objects.

    Raises FactoryError for a label that names no class.
    """
    for sample in read_samples(pairs, split):
        _write_image(sample.images["noisy"], folder / "images" / split, sample.key)
        _write_image(sample.images["clean"], folder / "clean" / split, sample.key)
        objects = [
            shown
            for shown in visible_objects(sample, pairs, exported.selection)
            if exported.has_room_for(shown)
        ]
        yield ExportedImage(sample.key, objects)


def _write_image(image: Array, folder: Path, key: str) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{key}.png").write_bytes(encode_png(stored_image(image, "uint8")))
