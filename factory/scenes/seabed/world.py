"""A location, built from its number."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...seeds import stream
from .appearance import Palette, Water, draw_palette, draw_water
from .biomes import PLACES, PlaceName, draw_terrain
from .fields import WORLD_SEED, Floats
from .meshes import mesh
from .path import Path, draw_loop, draw_path
from .placement import KINDS, Item, Site, furnish
from .rasterizer import Objects, objects_of
from .terrain import Terrain


@dataclass(frozen=True, eq=False)
class World:
    """One location.

    labels, instances: (N,) by object number; pebbles have 0.  finishes: (N, 3) fouling, silt and
    bump of each object, see `placement.Kind`.
    """

    location: int
    place: str
    terrain: Terrain
    path: Path
    water: Water
    palette: Palette
    objects: Objects
    labels: npt.NDArray[np.uint8]
    instances: npt.NDArray[np.uint16]
    finishes: Floats


def build_world(
    location: int, places: tuple[PlaceName, ...], density: float, kinds: Iterable[str] | None
) -> World:
    """Build location number `location`; it is a place of kind `places[location % len(places)]`."""
    name = places[location % len(places)]
    place = PLACES[name]
    rng = stream(WORLD_SEED, "seabed", location, "ground")
    heading = rng.uniform(0, 2 * np.pi)
    terrain = draw_terrain(rng, place, heading)
    rng = stream(WORLD_SEED, "seabed", location, "path")
    loop = draw_loop(rng, place, terrain, heading)
    path = draw_path(rng, place, terrain, loop, heading)
    site = Site(rng, place, terrain, loop, heading)
    items = furnish(site, location, density, kinds)
    rng = stream(WORLD_SEED, "seabed", location, "light")
    water = draw_water(rng, place.waters)
    palette = draw_palette(rng)
    objects, labels, instances, finishes = _assemble(items)
    return World(
        location, name, terrain, path, water, palette, objects, labels, instances, finishes,
    )  # fmt: skip


def _assemble(
    items: list[Item],
) -> tuple[Objects, npt.NDArray[np.uint8], npt.NDArray[np.uint16], Floats]:
    if not items:  # an empty mesh has no shape: one triangle far below the ground
        items = [Item(mesh(np.eye(3) - [0, 0, 1e4], [[0, 1, 2]]), None)]
    labels = np.array([item.label for item in items], dtype=np.uint8)
    named = labels > 0
    instances = np.where(named, np.cumsum(named), 0).astype(np.uint16)
    finish = [KINDS[item.kind or "Boulder"] for item in items]
    finishes = np.array([(kind.fouling, kind.silt, kind.bump) for kind in finish], np.float32)
    return objects_of([item.mesh for item in items]), labels, instances, finishes
