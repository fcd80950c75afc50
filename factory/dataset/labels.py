"""What the numbers of `Frame.segmentation` mean; loads nothing else."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Literal, get_args

ObjectName = Literal[
    "Bottle", "Can", "Chain", "Drink-carton", "Hook", "Propeller", "Shampoo-bottle",
    "Standing-bottle", "Tire", "Valve", "Wall", "Boulder", "Pipe", "Pillar", "Frame", "Anchor",
    "Block", "Coral", "Plant", "Barrel",
]  # fmt: skip

# 0 to 11 are those of the Marine Debris Dataset; ground is 0.
CLASSES: tuple[str, ...] = ("Background", *get_args(ObjectName))


FITTING = "Fitting"
"""What belongs to a place and is no object to be found, such as a rope: a class without numbers."""


def class_names(own: Iterable[str]) -> tuple[str, ...]:
    """CLASSES and, from their end on, the classes of the user's own objects."""
    return tuple(dict.fromkeys((*CLASSES, *own)))


def classes_of(config: Mapping[str, Any]) -> tuple[str, ...]:
    """The class names of a dataset, from the settings in its shards."""
    return class_names(config.get("classes", ()))
