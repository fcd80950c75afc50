"""A location, built from its number."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...labels import class_names
from ...seeds import stream
from .biomes import PLACES, Look, PlaceName, draw_look, draw_terrain
from .camera import Objects, objects_of
from .fields import WORLD_SEED, Floats
from .meshes import mesh
from .own_objects import Owned, place_own
from .path import Path, draw_loop, draw_path
from .placement import Item, Site, furnish
from .terrain import Terrain
from .things import KINDS, PLAIN


@dataclass(frozen=True, eq=False)
class World:
    """One location.

    finishes: (N, 3) fouling, silt and bump of each object, see `things.Kind`.  first_own: number in
    `objects.instances` from which on they are the user's own.
    """

    location: int
    terrain: Terrain
    path: Path
    look: Look
    objects: Objects
    finishes: Floats
    first_own: int = 1 << 16


def build_world(
    location: int,
    places: tuple[PlaceName, ...],
    density: float,
    kinds: Iterable[str] | None,
    own: Sequence[Owned] = (),
) -> World:
    """Build location number `location`; it is a place of kind `places[location % len(places)]`.

    own: the user's objects, put there when all else lies there.
    """
    place = PLACES[places[location % len(places)]]
    rng = stream(WORLD_SEED, "seabed", location, "ground")
    heading = rng.uniform(0, 2 * np.pi)
    terrain = draw_terrain(rng, place, heading)
    rng = stream(WORLD_SEED, "seabed", location, "path")
    loop = draw_loop(rng, place, terrain, heading)
    path = draw_path(rng, place, terrain, loop, heading)
    site = Site(rng, place, terrain, loop, heading)
    items = furnish(site, location, density, kinds)
    first_own = 1 + sum(item.kind is not None for item in items)
    place_own(site, path, location, own)
    classes = class_names(one.settings.label for one in own)
    if not items:  # an empty mesh has no shape: one triangle far below the ground
        items = [Item(mesh(np.eye(3) - [0, 0, 1e4], [[0, 1, 2]]), None)]
    labels = np.array([classes.index(item.kind) if item.kind else 0 for item in items], np.uint8)
    finish = [KINDS.get(item.kind or "Boulder", PLAIN) for item in items]
    return World(
        location,
        terrain,
        path,
        draw_look(stream(WORLD_SEED, "seabed", location, "light"), place),
        objects_of([item.mesh for item in items], labels),
        np.array([(kind.fouling, kind.silt, kind.bump) for kind in finish], np.float32),
        first_own,
    )
