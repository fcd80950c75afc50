"""The kinds of objects: their builders and surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import debris, nature, structures
from .meshes import Mesh


@dataclass(frozen=True)
class Kind:
    """One kind of object.

    build: draws one that rests on z = 0; None where it is built to fit its place (`site.py`).
    fouling, silt: how readily algae and fallen sediment cover it, 0 to 1.
    bump: strength of fine surface roughness in the light, 0 to 1.
    upright: it stays vertical on a slope.
    """

    build: Callable[[np.random.Generator], Mesh] | None
    fouling: float
    silt: float
    bump: float
    upright: bool = False


KINDS: dict[str, Kind] = {
    "Bottle": Kind(debris.bottle, 0.25, 0.4, 0.1),
    "Can": Kind(debris.can, 0.25, 0.35, 0.15),
    "Chain": Kind(None, 0.5, 0.4, 0.6),
    "Drink-carton": Kind(debris.drink_carton, 0.2, 0.4, 0.1),
    "Hook": Kind(debris.hook, 0.4, 0.3, 0.5),
    "Propeller": Kind(debris.propeller, 0.45, 0.35, 0.35),
    "Shampoo-bottle": Kind(debris.shampoo_bottle, 0.2, 0.35, 0.1),
    "Standing-bottle": Kind(debris.standing_bottle, 0.25, 0.2, 0.1, upright=True),
    "Tire": Kind(debris.tire, 0.35, 0.7, 0.35),
    "Valve": Kind(debris.valve, 0.4, 0.35, 0.4),
    "Wall": Kind(None, 0.7, 0.3, 0.8, upright=True),
    "Boulder": Kind(nature.boulder, 0.6, 0.6, 1.0),
    "Pipe": Kind(None, 0.5, 0.6, 0.5),
    "Pillar": Kind(None, 0.6, 0.1, 0.9, upright=True),
    "Frame": Kind(structures.frame, 0.45, 0.3, 0.5),
    "Anchor": Kind(structures.anchor, 0.45, 0.35, 0.6),
    "Block": Kind(structures.block, 0.5, 0.6, 0.8),
    "Coral": Kind(nature.coral, 0.0, 0.0, 0.9, upright=True),
    "Plant": Kind(nature.plant, 0.0, 0.0, 0.1, upright=True),
    "Barrel": Kind(debris.barrel, 0.45, 0.5, 0.5),
}
