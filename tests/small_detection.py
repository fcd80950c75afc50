"""Small images with bright objects, for the tests of detectors and of `evaluate transfer`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from simnfnd.factory.common.array_types import Array, UInt8s, UInt16s
from simnfnd.factory.dataset.schema import Pair
from simnfnd.models.detection.images import LabelledImage, WorkingImage, find_fan
from tests.small_dataset import add_shard

HEIGHT = 96
WIDTH = 64
CLASSES = ("Tire", "Bottle")

Drawn = tuple[UInt8s, UInt16s, list[list[int]], list[int]]


def draw_scene(rng: np.random.Generator, count: int = 2) -> Drawn:
    """A noisy image of bright squares (Tire) and upright bars (Bottle).

    Returns the image (H, W), the number of the object that each pixel shows, boxes as left, top,
    right, bottom, and positions in CLASSES.
    """
    image = 60 + 12 * rng.standard_normal((HEIGHT, WIDTH))
    instance = np.zeros((HEIGHT, WIDTH), np.uint16)
    boxes = []
    labels = []
    for number in range(1, count + 1):
        label = int(rng.integers(2))
        width, height = ((16, 16), (8, 24))[label]
        left = int(rng.integers(0, WIDTH - width))
        top = (number - 1) * HEIGHT // count + int(rng.integers(0, HEIGHT // count - height))
        image[top : top + height, left : left + width] += 120
        instance[top : top + height, left : left + width] = number
        boxes.append([left, top, left + width, top + height])
        labels.append(label)
    return np.clip(image, 5, 255).astype(np.uint8), instance, boxes, labels


def working_images(count: int, seed: int = 0) -> list[WorkingImage]:
    """Images of 96x64 as a detector takes them."""
    rng = np.random.default_rng(seed)
    images = []
    for number in range(count):
        image, _, boxes, labels = draw_scene(rng)
        name = f"{number:03d}"
        corners = np.array(boxes, np.float32)
        labelled = LabelledImage(name, name, image, corners, np.array(labels, np.int64))
        images.append(WorkingImage(labelled, 1.0, find_fan(image)))
    return images


def write_labelled_dataset(root: Path, train: int = 8, test: int = 2) -> Path:
    """A dataset with /segmentation and /instance, as `simnfnd make` leaves it."""
    rng = np.random.default_rng(3)
    classes = {"Tire": 9, "Bottle": 1}
    for split, count in (("train", train), ("test", test)):
        if not count:
            continue
        pairs = []
        for number in range(count):
            image, instance, _, labels = draw_scene(rng)
            lookup = np.array([0, *(classes[CLASSES[label]] for label in labels)], np.uint8)
            record: dict[str, float | int | str] = {
                "location": "test", "scene": split, "frame": f"{number:04d}", "variant": 0,
            }  # fmt: skip
            values = image.astype(np.float32) / 255
            layers: dict[str, Array] = {
                "segmentation": lookup[instance],
                "instance": instance,
            }
            pairs.append(Pair(values, values, image < 0, record, layers))
        add_shard(root, f"{split}/shard-00000.h5", pairs, layers=("segmentation",))
    return root


def coco_content(groups: int = 4, per_group: int = 2, seed: int = 9) -> dict[str, Any]:
    """A file of annotations; `pixels` of each image is to be popped."""
    rng = np.random.default_rng(seed)
    content: dict[str, Any] = {
        "images": [],
        "annotations": [],
        "categories": [
            {"id": 1, "name": "Tire"}, {"id": 2, "name": "Bottle"}, {"id": 5, "name": "Wall"},
        ],
    }  # fmt: skip
    for number in range(groups * per_group):
        image, _, boxes, labels = draw_scene(rng)
        entry = {
            "id": number + 1, "file_name": f"{number:04d}.png", "width": WIDTH, "height": HEIGHT,
            "group": number // per_group, "pixels": image,
        }  # fmt: skip
        content["images"].append(entry)
        for (left, top, right, bottom), label in zip(boxes, labels, strict=True):
            content["annotations"].append(
                {
                    "id": len(content["annotations"]) + 1, "image_id": number + 1,
                    "category_id": label + 1, "bbox": [left, top, right - left, bottom - top],
                }
            )  # fmt: skip
    return content


def write_coco(folder: Path, content: dict[str, Any]) -> Path:
    """images/ and annotations.json."""
    (folder / "images").mkdir(parents=True)
    for entry in content["images"]:
        pixels = entry.pop("pixels", None)
        if pixels is not None:
            cv2.imwrite(str(folder / "images" / entry["file_name"]), pixels)
    (folder / "annotations.json").write_text(json.dumps(content))
    return folder
