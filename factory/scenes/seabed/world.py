"""A location built from its number, and the frames that are taken of it."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...frame import Frame, FrameRef
from ...seeds import stream
from .appearance import Palette, Scene, Water, draw_palette, draw_water, photograph
from .biomes import PLACES, PlaceName, draw_terrain
from .depth_dropout import measured
from .fields import WORLD_SEED, Floats
from .meshes import mesh
from .movement import Movement, moved
from .optics import Optics
from .path import Path, draw_loop, draw_path
from .placement import KINDS, Item, Site, furnish
from .rasterizer import Objects, Pose, directions, lens_of, objects_of, z_buffer
from .terrain import Terrain, view_mesh
from .viewpoint import choose_pose


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


def take(
    world: World, frame: int, ref: FrameRef, optics: Optics, movement: Movement | None = None
) -> Frame:
    """Take frame number `frame` of a location.

    The pose is the one that FLSea's camera would choose, however wide this one sees; with a
    movement, of a platform that begins there.
    """
    where = choose_pose(world, frame)
    if movement is not None:
        where = Pose(*moved(where.eye, where.rotation, movement))
    azimuths, elevations = _field_of_view(where, optics)
    # The mesh is as fine as the pixels: of a camera that sees 45 degrees, so many across.
    fine = min(max(optics.width / optics.across / 968, 0.35), 1.5)
    shape = (int(370 * fine), int(280 * fine * optics.across))
    ground = view_mesh(world.terrain, where.eye, azimuths, elevations, shape)
    every = np.ones(len(world.labels), dtype=np.bool_)
    seen = z_buffer(where, optics, ground.points, world.objects, every)
    rng = stream(WORLD_SEED, "seabed", world.location, "frame", frame)
    scene = Scene(
        where, optics, ground, world.objects, world.finishes, world.palette, world.water,
        world.terrain.offset_m,
    )  # fmt: skip
    rgb = photograph(scene, seen, rng.uniform(0.68, 0.92))
    depth_m = seen.depth_m
    range_m = depth_m * _lengths(optics)
    keep = measured(rng, depth_m, range_m, world.water.clear_m)
    things = np.append(np.uint16(0), world.objects.owner + np.uint16(1))
    first_object = 2 * (shape[0] - 1) * (shape[1] - 1)
    number = things.take(np.maximum(seen.which - (first_object - 1), 0)) * (
        range_m < world.water.clear_m
    )
    return Frame(
        ref=ref,
        rgb=rgb,
        depth_m=np.where(keep, depth_m, np.float32(0)),
        intrinsics=optics.intrinsics,
        world_from_camera=where.matrix,
        segmentation=np.append(np.uint8(0), world.labels).take(number),
        instance=np.append(np.uint16(0), world.instances).take(number),
        time_s=None if movement is None else movement.time_s,
        altitude_m=_altitude_m(world.terrain, where.eye),
    )


def _altitude_m(terrain: Terrain, eye: npt.NDArray[np.float64]) -> float:
    """Height of a camera above the ground right under it."""
    return float(eye[2] - terrain.height_m(eye[:1], eye[1:2])[0])


@functools.lru_cache(maxsize=2)
def _lengths(optics: Optics) -> Floats:
    """(H, W) lengths of the pixels' rays for a length of 1 along the optical axis."""
    fx, fy, cx, cy = lens_of(optics)
    across = (((np.arange(optics.width) - cx) / fx) ** 2).astype(np.float32)
    down = (((np.arange(optics.height) - cy) / fy) ** 2).astype(np.float32)
    return np.asarray(np.sqrt(1 + across[None] + down[:, None]))


def _field_of_view(where: Pose, optics: Optics) -> tuple[tuple[float, float], tuple[float, float]]:
    """Azimuths (in order, within a turn) and elevations, with a margin, of a view's directions."""
    every = max(optics.width // 121, 1)
    toward = directions(
        where.rotation, optics.intrinsics, optics.width + every, optics.height + every, every
    ).astype(np.float64)
    border = np.concatenate([toward[0], toward[-1], toward[:, 0], toward[:, -1]])
    middle = toward[toward.shape[0] // 2, toward.shape[1] // 2]
    centre = np.arctan2(middle[1], middle[0])
    aside = np.arctan2(border[:, 1], border[:, 0]) - centre
    aside = (aside + np.pi) % (2 * np.pi) - np.pi
    up = np.arctan2(border[:, 2], np.hypot(border[:, 0], border[:, 1]))
    # Walls lean over the edge of the view by their relief, hence the margin.
    azimuths = (float(centre + aside.min() - 0.06), float(centre + aside.max() + 0.06))
    return azimuths, (float(up.min() - 0.04), float(up.max() + 0.04))
