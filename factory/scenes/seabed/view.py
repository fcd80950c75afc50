"""Frames of a location: what a camera at a pose of its path sees and measures."""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from ...frame import Frame, FrameRef
from ...seeds import stream
from .appearance import Scene, photograph
from .depth_dropout import measured
from .fields import WORLD_SEED, Floats
from .movement import Movement, moved
from .optics import Optics
from .rasterizer import Pose, directions, lens_of, z_buffer
from .terrain import Terrain, view_mesh
from .viewpoint import choose_pose
from .world import World


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
