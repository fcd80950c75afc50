"""A location built from its number, and the frames that are taken of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from simnfnd.factory.frame import Frame, FrameRef
from simnfnd.factory.scenes.seabed.appearance import Finishes, Palette, appearance, draw_palette
from simnfnd.factory.scenes.seabed.casting import (
    Objects,
    Pose,
    cast,
    directions,
    objects_scene,
    pose,
    raycasting_scene,
    rays_from,
    view,
)
from simnfnd.factory.scenes.seabed.fields import WORLD_SEED, Floats
from simnfnd.factory.scenes.seabed.gaps import MOST_LOST, measured
from simnfnd.factory.scenes.seabed.movement import Movement, moved
from simnfnd.factory.scenes.seabed.names import PlaceName
from simnfnd.factory.scenes.seabed.objects.kinds import KINDS
from simnfnd.factory.scenes.seabed.objects.meshes import grid_triangles, join, mesh
from simnfnd.factory.scenes.seabed.objects.site import Item, Site, furnish
from simnfnd.factory.scenes.seabed.optics import Optics, camera
from simnfnd.factory.scenes.seabed.path import Path, draw_loop, draw_path
from simnfnd.factory.scenes.seabed.photo import photograph
from simnfnd.factory.scenes.seabed.places import PLACES, draw_terrain
from simnfnd.factory.scenes.seabed.terrain import FAR_M, Terrain, view_mesh
from simnfnd.factory.scenes.seabed.water import Water, draw_water
from simnfnd.factory.seeds import stream

if TYPE_CHECKING:
    from open3d.t.geometry import RaycastingScene

COARSE_M = 0.3


@dataclass(frozen=True, eq=False)
class World:
    """One location.  labels, item numbers and finishes are by object number (pebbles have 0, 0).

    coarse: the whole ground as a ray-casting scene, for choosing views.
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
    finishes: Finishes
    coarse: RaycastingScene


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
        _coarse_ground(terrain),
    )  # fmt: skip


def _assemble(
    items: list[Item],
) -> tuple[Objects, npt.NDArray[np.uint8], npt.NDArray[np.uint16], Finishes]:
    if not items:  # a ray-casting scene needs a triangle: one far below the ground
        items = [Item(mesh(np.eye(3) - [0, 0, 1e4], [[0, 1, 2]]), None)]
    whole = join(item.mesh for item in items)
    counts = [len(item.mesh.triangles) for item in items]
    owner = np.repeat(np.arange(len(items), dtype=np.uint16), counts)
    labels = np.array([item.label for item in items], dtype=np.uint8)
    named = labels > 0
    instances = np.where(named, np.cumsum(named), 0).astype(np.uint16)
    finish = [KINDS[item.kind or "Boulder"] for item in items]
    finishes = Finishes(
        *(
            np.array([getattr(kind, name) for kind in finish], dtype=np.float32)
            for name in ("fouling", "silt", "bump")
        )
    )
    return objects_scene(whole, owner), labels, instances, finishes


def _coarse_ground(terrain: Terrain) -> RaycastingScene:
    side = np.arange(-FAR_M, FAR_M, COARSE_M)
    x, y = np.meshgrid(side, side, indexing="ij")
    points = np.stack([x, y, terrain.height_m(x, y)], axis=-1)
    return raycasting_scene(points.reshape(-1, 3), grid_triangles(len(side), len(side)))


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
    toward = directions(where.rotation, optics.intrinsics, optics.width, optics.height)
    azimuths, elevations = _field_of_view(toward)
    # The mesh is as fine as the pixels: of a camera that sees 45 degrees, so many across.
    fine = min(max(optics.width / optics.across / 968, 0.35), 1.5)
    shape = (int(440 * fine), int(320 * fine * optics.across))
    ground = view_mesh(world.terrain, where.eye, azimuths, elevations, shape)
    ground_scene = raycasting_scene(ground.points.reshape(-1, 3), ground.triangles)
    hits = view(where.eye, toward, ground, ground_scene, world.objects)
    rng = stream(WORLD_SEED, "seabed", world.location, "frame", frame)
    albedo, normals = appearance(hits, world.terrain, world.palette, world.finishes)
    scenes = (ground_scene, world.objects.scene)
    rgb = photograph(rng, hits, albedo, normals, toward, world.water, scenes)
    range_m = hits.depth_m * np.sqrt((toward**2).sum(axis=-1))
    keep = measured(rng, hits.depth_m, range_m, world.water.clear_m)
    named = hits.on_object & (range_m < world.water.clear_m)
    return Frame(
        ref=ref,
        rgb=rgb,
        depth_m=np.where(keep, hits.depth_m, np.float32(0)),
        intrinsics=optics.intrinsics,
        world_from_camera=where.matrix,
        segmentation=np.where(named, world.labels[hits.owner], np.uint8(0)),
        instance=np.where(named, world.instances[hits.owner], np.uint16(0)),
        time_s=None if movement is None else movement.time_s,
        altitude_m=_altitude_m(world.terrain, where.eye),
    )


def _altitude_m(terrain: Terrain, eye: npt.NDArray[np.float64]) -> float:
    """Height of a camera above the ground right under it."""
    return float(eye[2] - terrain.height_m(eye[:1], eye[1:2])[0])


def _field_of_view(toward: Floats) -> tuple[tuple[float, float], tuple[float, float]]:
    """Azimuths (in order, within a turn) and elevations, with a margin, of a view's directions."""
    border = np.concatenate([toward[0], toward[-1], toward[:, 0], toward[:, -1]]).astype(np.float64)
    middle = toward[toward.shape[0] // 2, toward.shape[1] // 2].astype(np.float64)
    centre = np.arctan2(middle[1], middle[0])
    aside = np.arctan2(border[:, 1], border[:, 0]) - centre
    aside = (aside + np.pi) % (2 * np.pi) - np.pi
    up = np.arctan2(border[:, 2], np.hypot(border[:, 0], border[:, 1]))
    # Walls lean over the edge of the view by their relief, hence the margin.
    azimuths = (float(centre + aside.min() - 0.06), float(centre + aside.max() + 0.06))
    return azimuths, (float(up.min() - 0.04), float(up.max() + 0.04))


@lru_cache(maxsize=2)  # all frames of a moving platform begin at one
def choose_pose(world: World, frame: int) -> Pose:
    """The pose of a frame: of a few ways to look from its place, the one that shows most.

    A good view has ground to throw shadows on, objects at middle range, something missing but not
    much, and nothing right before the lens.
    """
    eye = world.path.eye(frame, world.terrain)
    heading, pitch, roll = world.path.attitude_deg(frame)
    every, optics = 16, camera(968, 608)
    # Between walls the way ahead is the view; in the open the camera turns to what lies there.
    turning = 0.012 if world.terrain.banks is not None else 0.004
    best, best_cost = None, np.inf
    for yaw in (0, 14, -14, 28, -28, 45, -45, 70, -70):
        for lower in (0, 5, -5, 10, 16):
            if not 8 <= pitch + lower <= 35:
                continue
            candidate = pose(eye, heading + yaw, pitch + lower, roll)
            toward = directions(
                candidate.rotation, optics.intrinsics, optics.width, optics.height, every
            )
            cost = _cost(world, candidate, toward) + turning * abs(yaw) + 0.01 * abs(lower)
            if cost < best_cost:
                best, best_cost = candidate, cost
    assert best is not None  # pitches from 8 to 35 degrees always include one
    return best


def _cost(world: World, candidate: Pose, toward: Floats) -> float:
    rays = rays_from(candidate.eye, toward)
    ground = cast(world.coarse, rays)["t_hit"]
    thing = cast(world.objects.scene, rays)
    depth = np.minimum(ground, thing["t_hit"])
    range_m = depth * np.sqrt((toward**2).sum(axis=-1))
    lost = float((range_m > world.water.clear_m).mean())
    on_object = thing["t_hit"] < ground
    owner = world.objects.owner[thing["primitive_ids"][on_object].astype(np.int64)]
    owner = owner[range_m[on_object] < 0.8 * world.water.clear_m]
    numbers = world.instances[owner]
    share = float((numbers > 0).mean()) * float(on_object.mean()) if numbers.size else 0.0
    variety = len(np.unique(numbers[numbers > 0]))
    too_near = float((depth < 0.9).mean())
    middle = float(np.median(depth[np.isfinite(depth)])) if np.isfinite(depth).any() else 99.0
    cost = 8 * max(lost - 0.34, 0) + 60 * max(lost - MOST_LOST + 0.06, 0)
    cost += 3 * max(0.03 - lost, 0) * 10
    cost += 12 * max(too_near - 0.02, 0) + 1.0 * max(1.4 - middle, 0) + 0.4 * max(middle - 4, 0)
    cost += 4 * max(share - 0.42, 0) - min(share, 0.25) * 4 - 0.05 * min(variety, 14)
    return cost
