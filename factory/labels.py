"""What the numbers of `Frame.segmentation` mean; loads nothing else."""

from __future__ import annotations

from typing import Literal, get_args

ObjectName = Literal[
    "Bottle",
    "Can",
    "Chain",
    "Drink-carton",
    "Hook",
    "Propeller",
    "Shampoo-bottle",
    "Standing-bottle",
    "Tire",
    "Valve",
    "Wall",
    "Boulder",
    "Pipe",
    "Pillar",
    "Frame",
    "Anchor",
    "Block",
    "Coral",
    "Plant",
    "Barrel",
]

# 0 to 11 are those of the Marine Debris Dataset; ground is 0.
CLASSES: tuple[str, ...] = ("Background", *get_args(ObjectName))
