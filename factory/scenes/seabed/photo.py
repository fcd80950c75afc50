"""From a view's hits to its colour picture: light, shade, water, lens and sensor."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...seeds import stream
from .appearance import Palette
from .fields import TILE, WORLD_SEED, Floats, dither, tiles
from .optics import Optics
from .rasterizer import Hits, Objects, Pose, lens_of, whole
from .terrain import GroundMesh
from .water import Water

_OCCLUSION_REACH_M = 0.45
_NEAR_MAP_M, _FAR_MAP_M = 6.0, 36.0  # sides of the two maps of what the sun meets
_BLOCKS = 64  # a side of such a map


@dataclass(frozen=True, eq=False)
class Scene:
    """What one view looks at, and with what."""

    where: Pose
    optics: Optics
    ground: GroundMesh
    objects: Objects
    finishes: Floats
    palette: Palette
    water: Water
    offset_m: tuple[float, float]


def photograph(rng: np.random.Generator, scene: Scene, hits: Hits) -> npt.NDArray[np.uint8]:
    """The (H, W, 3) picture of what a view meets."""
    from .loops import colour_loops

    water, where = scene.water, scene.where
    lit, free = _light(scene, hits)
    colour = np.empty_like(hits.base)
    noise = tiles()
    colour_loops.photograph(
        hits.depth_m, hits.normals, hits.base, hits.owner, scene.finishes,
        scene.palette.table, np.float32(scene.palette.turf),
        where.eye, where.rotation, lens_of(scene.optics),
        np.array(scene.offset_m, dtype=np.float32),
        noise.texture, noise.fine, noise.caustics, dither(),
        water.table, np.array(water.sun_direction, dtype=np.float32),
        np.float32(water.caustics), np.float32(water.caustic_period_m),
        np.float32(3 * water.clear_m), lit, free, colour,
    )  # fmt: skip
    _add_motes(rng, colour, water)
    # The camera sets its black level on the haze, as far as the haze has one colour.
    veil = np.asarray(water.veil, dtype=np.float32) / max(water.veil)
    haze = np.percentile(_brightest(colour[::4, ::4]), 1)
    return develop(rng, colour, np.float32(0.6 * haze) * veil)


def _light(scene: Scene, hits: Hits) -> tuple[Floats, Floats]:
    """Sunlight and openness of every second pixel: water scatters light into shadows.

    Sunlight is looked up in two maps of heights along its rays, a fine one of what is near and a
    coarse one.  Openness is the share of the near surroundings that is open: dark in corners and
    under things.
    """
    from .loops.surface_loops import light, sun_blocks

    shape = tuple(-(-size // 2) for size in hits.depth_m.shape)
    lit, free = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    sun, where, optics = scene.water.sun_direction, scene.where, scene.optics
    slope = np.array([sun[0] / sun[2], sun[1] / sun[2]], dtype=np.float32)
    wide = max(optics.across, 1.0)
    cells = 1024 if optics.width >= 600 else 512
    near_place = _map_place(scene, slope, cells, _NEAR_MAP_M * wide, 3.0)
    far_place = _map_place(scene, slope, cells, _FAR_MAP_M, 15.0 if wide < 2 else 8.0)
    farthest_m = np.float32(3 * scene.water.clear_m)
    blocks = np.empty((2, _BLOCKS, _BLOCKS), dtype=np.bool_)
    sun_blocks(
        hits.depth_m, hits.normals, where.eye, where.rotation, lens_of(optics), slope, near_place,
        far_place, cells, farthest_m, blocks,
    )  # fmt: skip
    near = _sun_map(scene, slope, near_place, cells, blocks[0])
    far = _sun_map(scene, slope, far_place, cells, blocks[1])
    light(
        hits.depth_m, hits.normals, hits.inverse, where.eye, where.rotation, lens_of(optics), slope,
        near, near_place, far, far_place, farthest_m, _cap(32), _OCCLUSION_REACH_M, lit, free,
    )  # fmt: skip
    return lit, _mean_of_patches(free)


def _map_place(scene: Scene, slope: Floats, cells: int, side_m: float, ahead_m: float) -> Floats:
    """Corner (x, y) of a sun map around a place ahead of the camera, and cells a metre."""
    eye, forward = scene.where.eye, scene.where.rotation[:2, 2]
    level = float(scene.ground.points[0, :, 2].mean())
    middle = eye[:2] + ahead_m * forward / np.sqrt((forward**2).sum()) - level * slope
    return np.array([*(middle - side_m / 2), cells / side_m], dtype=np.float32)


def _sun_map(
    scene: Scene, slope: Floats, place: Floats, cells: int, blocks: npt.NDArray[np.bool_]
) -> Floats:
    """(cells, cells) greatest height that the sun's light meets, where `blocks` are looked at."""
    from .loops.ground_loops import shading_triangles
    from .loops.raster_loops import cover

    points, objects = scene.ground.points, scene.objects
    tops = np.full((cells, cells), -np.inf, dtype=np.float32)
    # Of the ground only what faces away from the sun can shade the rest.
    triangles, turn = np.empty((2 * points.shape[0] * points.shape[1], 3), np.int32), -_turn(points)
    count = shading_triangles(points, slope, place, np.float32(turn), cells, triangles)
    parts = whole(points.shape[0] * points.shape[1], count)
    cover(points.reshape(-1, 3), triangles, parts, slope, place, turn, tops)
    parts = objects.parts(_over(objects.balls, slope, place, cells, blocks))
    cover(objects.mesh.vertices, objects.mesh.triangles, parts, slope, place, 0, tops)
    return tops


def _over(
    balls: npt.NDArray[np.float64],
    slope: Floats,
    place: Floats,
    cells: int,
    blocks: npt.NDArray[np.bool_],
) -> npt.NDArray[np.bool_]:
    """(N,) whether the shadows of balls (N, 4) may fall on a block that is looked at."""
    centres, radius = balls[:, :3], balls[:, 3] * np.sqrt(1 + (slope**2).sum())
    middle = (centres[:, :2] - centres[:, 2:] * slope - place[:2]) * place[2]
    reach = radius[:, None] * place[2] + 2  # cells; two more for rounding
    size = cells / len(blocks)
    low = np.clip(np.floor((middle - reach) / size), 0, len(blocks)).astype(np.int64)
    high = np.clip(np.floor((middle + reach) / size) + 1, 0, len(blocks)).astype(np.int64)
    sums = np.zeros((len(blocks) + 1, len(blocks) + 1), dtype=np.int64)
    sums[1:, 1:] = blocks.cumsum(axis=0).cumsum(axis=1)
    (left, top), (right, bottom) = low.T, high.T
    seen = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
    return np.asarray(seen > 0)


def _turn(points: Floats) -> int:
    """Which way the triangles of a level (R, C, 3) grid turn as seen from above: 1 or -1."""
    (ax, ay), (bx, by), (cx, cy) = points[0, 0, :2], points[1, 0, :2], points[1, 1, :2]
    return 1 if (bx - ax) * (cy - ay) > (by - ay) * (cx - ax) else -1


def _mean_of_patches(values: Floats) -> Floats:
    """Mean over 4 x 4 neighbours, so that the ways that a patch looks are joined."""
    for axis in (0, 1):
        sides = [(0, 0), (0, 0)]
        sides[axis] = (2, 1)
        padded = np.pad(values, sides, mode="reflect")
        count = values.shape[axis]
        cuts = [padded[k : k + count] if axis == 0 else padded[:, k : k + count] for k in range(4)]
        values = (cuts[0] + cuts[1] + (cuts[2] + cuts[3])) * np.float32(0.25)
    return np.ascontiguousarray(values)


@functools.cache
def _cap(count: int) -> Floats:
    """(count, 3) unit directions spread evenly over the upper half of a sphere about +z."""
    k = np.arange(count)
    z = 1 - (k + 0.5) / count * 0.93
    turn = k * np.pi * (3 - np.sqrt(5))
    flat = np.sqrt(1 - z**2)
    cap = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=-1)
    return np.asarray(cap, dtype=np.float32)


def _add_motes(rng: np.random.Generator, colour: Floats, water: Water) -> None:
    """Specks that drift before the lens, out of focus."""
    height, width = colour.shape[:2]
    for _ in range(int(rng.integers(0, water.motes + 1))):
        radius = float(rng.uniform(0.6, 2.6)) * width / 968
        x, y = rng.uniform(0, width), rng.uniform(0, height)
        reach = int(3 * radius) + 1
        left, top = max(int(x) - reach, 0), max(int(y) - reach, 0)
        patch = colour[top : int(y) + reach + 1, left : int(x) + reach + 1]
        dy = np.arange(top, top + patch.shape[0])[:, None] - y
        dx = np.arange(left, left + patch.shape[1])[None, :] - x
        spot = np.exp(-(dx**2 + dy**2) / (2 * radius**2)) * rng.uniform(0.02, 0.14)
        patch += (spot[..., None] * (np.asarray(water.veil) + 0.25)).astype(np.float32)


def develop(rng: np.random.Generator, colour: Floats, haze: Floats) -> npt.NDArray[np.uint8]:
    """Lens blur and vignette, exposure, sensor noise and sRGB-like gamma.

    colour: (H, W, 3) linear.  haze: (3,) what the black level takes away.
    """
    from .loops.picture_loops import expose, through_lens

    seen = np.empty_like(colour)
    through_lens(colour, haze.astype(np.float32), _blur_weights(), seen)
    # Exposure: the bright parts of the picture fill most of the scale, whatever the water.
    bright = np.percentile(_brightest(seen[::4, ::4]), 97)
    gain = np.float32(rng.uniform(0.68, 0.92)) / max(float(bright), 1e-3)
    right, down = rng.integers(0, TILE, 2)
    picture = np.empty(colour.shape, dtype=np.uint8)
    expose(seen, np.float32(gain), _sensor_noise(), int(down), int(right), _gamma(), picture)
    return picture


@functools.cache
def _blur_weights() -> Floats:
    """(2,) a Gaussian of 0.55 pixels: the pixel and each neighbour."""
    beside = float(np.exp(-1 / (2 * 0.55**2)))
    return np.array([1, beside], dtype=np.float32) / np.float32(1 + 2 * beside)


@functools.cache
def _gamma() -> npt.NDArray[np.uint8]:
    level = np.arange(4096) / 4095
    return np.asarray(np.round(255 * level ** (1 / 2.2)), dtype=np.uint8)


@functools.cache
def _sensor_noise() -> Floats:
    rng = stream(WORLD_SEED, "seabed", "sensor")
    return rng.standard_normal((TILE, TILE, 3), dtype=np.float32)


def _brightest(colour: Floats) -> Floats:
    """(H, W) greatest of the three channels; numpy's own takes ten times as long for so few."""
    red, green, blue = colour[..., 0], colour[..., 1], colour[..., 2]
    return np.asarray(np.maximum(np.maximum(red, green), blue))
