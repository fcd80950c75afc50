"""The names that settings and labels use; loads nothing else."""

from __future__ import annotations

from typing import Literal, get_args

KindName = Literal[
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

# Numbers of `Frame.segmentation`.  0 to 11 are those of the Marine Debris Dataset; ground is 0.
CLASSES: tuple[str, ...] = ("Background", *get_args(KindName))

# The order is the order in which locations 0, 1, 2, ... take them.
PlaceName = Literal[
    "debris", "canyon", "reef", "pier", "pipeline", "rubble", "quay", "sand", "garden", "wall"
]

PLACE_NAMES: tuple[PlaceName, ...] = get_args(PlaceName)
