"""Real images with boxes in the form of COCO, checked before anything is computed from them."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Int64s
from ...factory.common.errors import FactoryError
from ...factory.common.files import real_path
from ...models.detection.boxes import Boxes, no_boxes
from ...models.detection.images import LabelledImage
from ...models.recordings.views import read_grey

_NAMES = ("annotations.json", "_annotations.coco.json", "instances.json")
# Larger numbers are no places in an image; NaN is not smaller, either.
_FARTHEST_PX = 1e9


@dataclass(frozen=True, eq=False)
class RealImage:
    """An image, its objects, and boxes in which detections do not count.

    ignored: (M, 4) px, of the classes to ignore.
    crowds, crowd_labels: (K, 4) px and (K,), of crowd regions: a detection of the class in one
        counts only where it finds an object.
    """

    labelled: LabelledImage
    ignored: Boxes
    crowds: Boxes = field(default_factory=no_boxes)
    crowd_labels: Int64s = field(default_factory=lambda: np.zeros(0, np.int64))


class _StatedBox(NamedTuple):
    """A box of the file: left, top, right, bottom, and whether it marks a crowd."""

    category: int
    corners: list[float]
    is_crowd: bool


@dataclass(frozen=True, eq=False)
class RealImages:
    """The labelled images of a folder.

    classes: names of the classes that are judged; labels of objects are positions in it.
    groups: whether the file states groups; else every image is its own.
    """

    name: str
    images: tuple[RealImage, ...]
    classes: tuple[str, ...]
    has_groups: bool


def read_coco(
    folder: str | Path,
    *,
    annotations: str | None = None,
    ignore: Sequence[str] = (),
    names: Mapping[str, str] | None = None,
) -> RealImages:
    """Read a folder of images and its annotations.

    annotations: the JSON file, relative to the folder; None looks for the usual names.
    ignore: classes of the file in whose boxes detections do not count.
    names: class of the file -> what it is called in the simulation.
    Images may name a `group`: those that show nearly the same scene are kept together.
    Raises FactoryError, one line, for a file that is not of this form.
    """
    root = Path(folder).expanduser()
    if not root.is_dir():
        raise FactoryError(f"real={root}: no such folder; give one with images and annotations")
    path = _annotations_path(root, annotations)
    content = _load(path)
    categories = _categories(path, content)
    renamed = names or {}
    for word, mapping in (("ignore", ignore), ("class_names", renamed)):
        for name in mapping:
            if name not in categories.values():
                known = ", ".join(categories.values())
                raise FactoryError(f"{word}: {path} has no class {name}; it has {known}")
    judged = {
        number: renamed.get(name, name) for number, name in categories.items() if name not in ignore
    }
    classes = tuple(dict.fromkeys(judged.values()))
    if not classes:
        raise FactoryError(f"ignore: no class of {path} is left to find")
    boxes_of = _boxes_by_image(path, content, categories)
    images = [
        _read_image(root, path, entry, boxes_of, judged, classes)
        for entry in _entries(path, content, "images")
    ]
    if sum(len(image.labelled.boxes) for image in images) == 0:
        raise FactoryError(f"{path}: has no box of a class that is not ignored")
    has_groups = all("group" in entry for entry in content["images"])
    return RealImages(real_path(root).name, tuple(images), classes, has_groups)


def _annotations_path(root: Path, file_name: str | None) -> Path:
    if file_name is not None:
        path = root / file_name
        if not path.is_file():
            raise FactoryError(f"annotations={file_name}: no such file in {root}")
        return path
    candidates = [root / name for name in _NAMES]
    candidates += sorted((root / "annotations").glob("*.json"))
    present = [path for path in candidates if path.is_file()]
    if not present:
        raise FactoryError(
            f"real={root}: no {_NAMES[0]} and no annotations/*.json; name the file with "
            "annotations=FILE"
        )
    return present[0]


def _load(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        reason = " ".join(str(error).split())[:120]
        raise FactoryError(f"{path}: no JSON file, or a damaged one: {reason}") from error
    if not isinstance(content, dict):
        raise FactoryError(f"{path}: not in the form of COCO: a JSON object is expected")
    return content


def _entries(path: Path, content: Mapping[str, Any], key: str) -> list[dict[str, Any]]:
    """The list of tables at a key."""
    entries = content.get(key)
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise FactoryError(f"{path}: not in the form of COCO: `{key}` must be a list of objects")
    if not entries:
        raise FactoryError(f"{path}: `{key}` is empty")
    return entries


def _categories(path: Path, content: Mapping[str, Any]) -> dict[int, str]:
    """Number -> name of every class."""
    categories: dict[int, str] = {}
    for entry in _entries(path, content, "categories"):
        number: Any = entry.get("id")
        name = entry.get("name")
        if not _is_whole(number) or not isinstance(name, str) or not name:
            raise FactoryError(f"{path}: a category needs a whole number `id` and a `name`")
        if number in categories:
            raise FactoryError(f"{path}: two categories have the id {number}")
        categories[int(number)] = name
    return categories


def _boxes_by_image(
    path: Path, content: Mapping[str, Any], categories: Mapping[int, str]
) -> dict[Any, list[_StatedBox]]:
    """Id of each image -> its boxes."""
    boxes: dict[Any, list[_StatedBox]] = {}
    for entry in _entries(path, content, "images"):
        number = entry.get("id")
        if not _is_whole(number) or number in boxes:
            raise FactoryError(f"{path}: every image needs an `id` of its own, a whole number")
        boxes[number] = []
    for entry in _entries(path, content, "annotations"):
        which = f"{path}: annotation {entry.get('id', '?')}"
        if entry.get("image_id") not in boxes:
            raise FactoryError(f"{which}: no image has the id {entry.get('image_id')!r}")
        if entry.get("category_id") not in categories:
            raise FactoryError(f"{which}: no category has the id {entry.get('category_id')!r}")
        box = entry.get("bbox")
        if not isinstance(box, list) or len(box) != 4 or not all(map(_is_number, box)):
            raise FactoryError(f"{which}: `bbox` must be [left, top, width, height] in pixels")
        left, top, width, height = map(float, box)
        if width <= 0 or height <= 0:
            raise FactoryError(f"{which}: width and height of `bbox` must be greater than 0")
        corners = [left, top, left + width, top + height]
        # COCO marks regions of uncounted objects by `iscrowd`, its successors by `ignore`.
        is_crowd = bool(entry.get("iscrowd") or entry.get("ignore"))
        stated = _StatedBox(int(entry["category_id"]), corners, is_crowd)
        boxes[entry["image_id"]].append(stated)
    return boxes


def _read_image(
    root: Path,
    path: Path,
    entry: Mapping[str, Any],
    boxes_of: Mapping[Any, list[_StatedBox]],
    judged: Mapping[int, str],
    classes: Sequence[str],
) -> RealImage:
    """One image with its boxes, clipped to it."""
    name = entry.get("file_name")
    if not isinstance(name, str):
        raise FactoryError(f"{path}: image {entry['id']}: `file_name` is missing")
    image_path = _find_image(root, path, name)
    if image_path is None:
        raise FactoryError(f"{path}: image {entry['id']}: no file {name} in {root} or its images/")
    image = np.rint(255 * read_grey(image_path)).astype(np.uint8)
    height, width = image.shape
    stated = (entry.get("height", height), entry.get("width", width))
    if stated != (height, width):
        raise FactoryError(
            f"{path}: image {entry['id']}: stated as {stated[1]}x{stated[0]} px, but {name} has "
            f"{width}x{height}"
        )
    boxes: list[list[float]] = []
    labels: list[int] = []
    ignored: list[list[float]] = []
    crowds: list[list[float]] = []
    crowd_labels: list[int] = []
    for category, corners, is_crowd in boxes_of[entry["id"]]:
        left, top, right, bottom = corners
        if left >= width or top >= height or right <= 0 or bottom <= 0:
            raise FactoryError(f"{path}: image {entry['id']}: a box lies outside {name}")
        if category in judged and is_crowd:
            crowds.append(corners)
            crowd_labels.append(classes.index(judged[category]))
        elif category in judged:
            boxes.append(corners)
            labels.append(classes.index(judged[category]))
        else:
            ignored.append(corners)
    labelled = LabelledImage(
        name,
        str(entry.get("group", f"image {entry['id']}")),
        image,
        _as_boxes(boxes),
        np.array(labels, np.int64),
    )
    return RealImage(
        labelled, _as_boxes(ignored), _as_boxes(crowds), np.array(crowd_labels, np.int64)
    )


def _find_image(root: Path, annotations: Path, name: str) -> Path | None:
    """Where an image lies: in images/ or the folder itself, or in the folder of its split.

    instances_train.json goes with images/train/ (`simnfnd export`) or train/ (COCO).
    """
    split = annotations.stem.removeprefix("instances_")
    folders = [root / "images", root, annotations.parent, root / "images" / split, root / split]
    inside = os.path.abspath(root)
    for folder in folders:
        path = Path(os.path.abspath(folder / name))
        # What a file of somebody else names elsewhere is none of the report's business.
        if path.is_relative_to(inside) and os.path.isfile(path):
            return path
    return None


def _as_boxes(corners: Sequence[Sequence[float]]) -> Boxes:
    return np.array(corners, np.float32).reshape(-1, 4) if corners else no_boxes()


def _is_whole(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_number(value: object) -> bool:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= _FARTHEST_PX
