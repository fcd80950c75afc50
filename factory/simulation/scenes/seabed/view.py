"""Frames of a location: which way a camera on its path looks, what it sees and measures."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ....common.array_types import Array, Bools, Draws, Float32s, Float64s, Floats, UInt8s
from ....common.seeds import stream
from ....dataset.frame_ref import FrameRef
from ...frames.frame import (
    GROUND_STEP_M,
    GROUND_STEPS,
    Frame,
    Intrinsics,
    Surroundings,
)
from ...meshes.camera import WORLD_SEED, Optics, Pose, Stance, ZBuffer, camera, centred, moved, pose
from ...meshes.triangle_mesh import grid_triangles
from ..flsea import CALIBRATED_SIZE
from ..moving import FARTHEST_M
from .terrain import TILE, Ground, tiles
from .world import SeabedWorld

Movement = Mapping[str, float]
_SUN_M = 400.0  # how far away the camera in the sun is
_SHADE_M = 14.0  # side of the ground that it sees
_SHADE_CELLS = 512  # pixels on a side of its image
_FURTHEST_M = 20.0  # stereo matching reaches no further, however clear the water


def take(
    world: SeabedWorld,
    frame: int,
    ref: FrameRef,
    optics: Optics,
    movement: Movement | None,
    boxes: bool,
    stance: Stance,
    *,
    gaps: bool = True,
    has_colours: bool = True,
) -> Frame:
    """Take frame number `frame` of a location.

    The pose is the one that FLSea's camera would choose, however wide this one sees, or as its
    stance says; with a movement, of a platform that begins there.
    gaps: whether depth is missing where stereo matching would not find it.
    has_colours: whether the image has the colours of the scene, or is black.
    """
    viewpoint = choose_pose(world, frame, stance)
    if movement is not None:
        viewpoint = moved(viewpoint, movement)
    azimuths, elevations = field_of_view(viewpoint, optics)
    # The mesh is as fine as the pixels: for FLSea's width and 45 degrees, 280 cells across.
    fine = min(max(optics.width / optics.across / CALIBRATED_SIZE[0], 0.35), 1.5)
    shape = (int(370 * fine), int(280 * fine * optics.across))
    ground = world.terrain.seen_from(viewpoint.eye, azimuths, elevations, shape)
    z_buffer = ZBuffer(viewpoint, optics, world.objects, ground.points)
    rng = stream(WORLD_SEED, "seabed", world.location, "frame", frame)
    exposure = rng.uniform(0.68, 0.92)
    rgb = np.zeros((optics.height, optics.width, 3), np.uint8)
    if has_colours:
        rgb = camera_image(world, ground, z_buffer, exposure)
    depth_m = z_buffer.depth_m
    clear_m = world.look.clear_m
    intrinsics = Intrinsics(*optics.lens)
    x, y = intrinsics.directions(optics.height, optics.width)
    lengths = np.sqrt(1 + (x**2).astype(np.float32) + (y[:, None] ** 2).astype(np.float32))
    range_m = depth_m * lengths
    if gaps:
        keep = measured(rng, depth_m, range_m, clear_m)
    else:
        clear_m = FARTHEST_M
        keep = depth_m < _FURTHEST_M
    segmentation, instance = (plane * (range_m < clear_m) for plane in z_buffer.shown)
    height_m = world.terrain.height_m(*viewpoint.eye[:2, None])[0]
    return Frame(
        ref=ref,
        rgb=rgb,
        depth_m=np.where(keep, depth_m, np.float32(0)),
        intrinsics=intrinsics,
        world_from_camera=viewpoint.matrix,
        segmentation=segmentation,
        instance=instance,
        time_s=None if movement is None else movement.get("time_s"),
        altitude_m=float(viewpoint.eye[2] - height_m),
        boxes=z_buffer.boxes(instance) if boxes else None,
    )


def altitude_m(world: SeabedWorld, stance: Stance, movement: Movement) -> float:
    """Height above the ground of a platform that has moved from the first pose, metres."""
    eye = moved(choose_pose(world, 0, stance), movement).eye
    return float(eye[2] - world.terrain.height_m(*eye[:2, None])[0])


@functools.lru_cache(maxsize=2)
def surroundings(world: SeabedWorld, stance: Stance) -> Surroundings:
    """Where the recording of a location begins, and the ground around."""
    start = choose_pose(world, 0, stance)
    steps_m = np.arange(-GROUND_STEPS, GROUND_STEPS + 1) * GROUND_STEP_M
    x, y = np.meshgrid(start.eye[0] + steps_m, start.eye[1] + steps_m)
    return Surroundings(start.matrix, world.terrain.height_m(x, y), GROUND_STEP_M)


def field_of_view(
    viewpoint: Pose, optics: Optics
) -> tuple[tuple[float, float], tuple[float, float]]:
    """Azimuths (in order, within a turn) and elevations, with a margin, of a view's directions."""
    every = max(optics.width // 121, 1)
    toward = optics.directions(viewpoint.rotation, every, every).astype(np.float64)
    border = np.concatenate([toward[0], toward[-1], toward[:, 0], toward[:, -1]])
    middle = toward[toward.shape[0] // 2, toward.shape[1] // 2]
    centre = np.arctan2(middle[1], middle[0])
    aside = np.arctan2(border[:, 1], border[:, 0]) - centre
    aside = (aside + np.pi) % (2 * np.pi) - np.pi
    up = np.arctan2(border[:, 2], np.hypot(border[:, 0], border[:, 1]))
    # Walls lean over the edge of the view by their relief, hence the margin.
    azimuths = (float(centre + aside.min() - 0.06), float(centre + aside.max() + 0.06))
    return azimuths, (float(up.min() - 0.04), float(up.max() + 0.04))


def camera_image(world: SeabedWorld, ground: Ground, z_buffer: ZBuffer, exposure: float) -> UInt8s:
    """The (H, W, 3) image of what a z-buffer met.

    exposure: how bright its bright parts are, 0 to 1.  Colours are those of every second pixel.
    """
    from . import kernels

    look = world.look
    objects = world.objects
    sun = sunlit(world, z_buffer.viewpoint)
    camera_sight, sun_sight = (
        tuple(part.astype(np.float32) for part in buffer.sight) for buffer in (z_buffer, sun)
    )
    ground_mesh = (
        *(part.reshape(-1, 3) for part in ground),
        grid_triangles(*ground.points.shape[:2]),
    )
    mesh = objects.mesh
    things_mesh = (mesh.vertices, objects.normals, mesh.colours, mesh.triangles)
    colour = kernels.shade_pixels(
        (ground_mesh, things_mesh, objects.owner, world.finishes),
        (camera_sight, (z_buffer.inverse, z_buffer.which)),
        (look.palette, np.float32(look.turf), look.water),
        (world.terrain.offset_m, tiles().texture),
        (look.sun_direction.astype(np.float32), sun_sight, sun.inverse),
    )
    # The camera sets its black level to the uniform part of the haze, and lets the
    # bright parts of the image fill most of the scale, whatever the water.
    sampled = colour[::4, ::4]
    haze = look.water[1]
    black = haze * np.float32(0.6 * np.percentile(sampled.max(axis=-1), 1) / haze.max())
    bright = max(float(np.percentile((sampled - black).max(axis=-1), 97)), 1e-3)
    gamma = np.round(255 * (np.arange(4096) / 4095) ** (1 / 2.2)).astype(np.uint8)
    gain = np.float32(exposure / bright)
    rgb: UInt8s = kernels.expose(colour, black, gain, gamma, *z_buffer.which.shape)
    return rgb


def sunlit(world: SeabedWorld, viewpoint: Pose) -> ZBuffer:
    """What a camera in the sun sees of the objects before a camera."""
    x, y, z = world.look.sun_direction
    ahead = viewpoint.rotation[:2, 2] / np.sqrt((viewpoint.rotation[:2, 2] ** 2).sum())
    middle = np.append(viewpoint.eye[:2] + 0.4 * _SHADE_M * ahead, viewpoint.eye[2] - 1)
    heading, pitch = np.rad2deg([np.arctan2(-y, -x), np.arcsin(z)])
    sun = pose(middle + _SUN_M * np.array([x, y, z]), heading, pitch, 0)
    optics = centred(_SUN_M * _SHADE_CELLS / _SHADE_M, _SHADE_CELLS, _SHADE_CELLS)
    return ZBuffer(sun, optics, world.objects)


def measured(rng: Draws, depth_m: Float32s, range_m: Float32s, clear_m: float) -> Bools:
    """(H, W) bool: pixels that keep their depth, decided for every second one.

    As in depth maps computed from camera images: far water, depth edges and patches have none.
    depth_m, range_m: (H, W), inf where there is only water.  clear_m: how far the water lets
    matching work; the border is ragged.  About 8 to 38 % are lost, small shares more often.
    """
    scale = depth_m.shape[1] / CALIBRATED_SIZE[0]
    near_m = np.minimum(depth_m[::2, ::2], np.float32(1e4))
    range_m = range_m[::2, ::2]
    broad, grain = _texture_noise(rng, near_m.shape, scale)
    ragged = np.minimum(np.float32(0.06) * broad + np.float32(0.03) * grain, np.float32(0.2))
    keep = range_m < clear_m * (1 + ragged)
    keep &= ~_behind_edges(near_m, broad + grain, scale)
    # What is missing so far counts towards the share that shall be missing.
    missing_share = 0.08 + 0.3 * rng.random() ** 2 - float(1 - keep.mean())
    if missing_share > 0 and keep.any():
        doubt = _matching_doubt(range_m, broad, grain, clear_m)
        keep &= doubt <= np.quantile(doubt[keep], 1 - min(missing_share / keep.mean(), 1))
    whole = keep.repeat(2, axis=0).repeat(2, axis=1)[: depth_m.shape[0], : depth_m.shape[1]]
    return np.asarray(whole & (depth_m < _FURTHEST_M))


def _texture_noise(rng: Draws, shape: tuple[int, ...], scale: float) -> tuple[Float32s, Float32s]:
    """Broad and grainy noise, (h, w) each, of standard deviation 1: the tile at a random place.

    scale: pixels of the image for each pixel of the tile.
    """
    from .kernels import STEPS

    rows, columns = (
        (rng.integers(TILE) + np.arange(size) / scale).astype(np.int64) % (TILE // 2)
        for size in shape
    )
    words = tiles().texture[rows[:, None], columns]
    # A word holds four signed channels of 8 bits; shifting to the left and back extracts one.
    step = np.float32(1 / STEPS)
    broad = (words << 24 >> 24) * step
    grain = (words << 16 >> 24) * step
    return broad, grain


def _behind_edges(near_m: Float32s, noise: Float32s, scale: float) -> Bools:
    """(h, w) bool: cracks along depth edges, on the far side, of a width that varies."""
    is_crack = np.zeros(near_m.shape, bool)
    for reach, level in ((max(round(2 * scale), 1), 0.6), (1, -0.7)):
        is_behind = near_m > np.float32(1.12) * least_around(near_m, reach)
        is_crack |= is_behind & (noise > np.float32(level))
    return is_crack


def _matching_doubt(
    range_m: Float32s, broad: Float32s, grain: Float32s, clear_m: float
) -> Float32s:
    """(h, w) how doubtful stereo matching is; it fails first where this is largest.

    That is far away, then near the image's border; a few blobs are anywhere.
    """
    down, across = (np.linspace(-1, 1, size, dtype=np.float32) ** 8 for size in range_m.shape)
    doubt = np.float32(0.3) * broad + np.float32(0.1) * grain
    doubt += np.float32(0.9) * np.maximum(across, down[:, None])
    doubt += np.float32(2.4 / clear_m) * np.minimum(range_m, np.float32(clear_m))
    return doubt


def least_around(values: Float32s, reach: int) -> Float32s:
    """(H, W) the least of the (2 reach + 1) x (2 reach + 1) values around each."""
    for _ in range(2):  # down the columns, then along the rows
        wide = np.pad(values, ((reach, reach), (0, 0)), constant_values=np.inf)
        shifted = (wide[k : k + len(values)] for k in range(2 * reach + 1))
        values = functools.reduce(np.minimum, shifted).T
    return values


# Two such cameras, to the left and to the right, see all that any candidate sees.
_LOOKOUT = Optics((70.0, 70.0, 101.0, 54.0), 203, 122)
_LOOKOUT_SIDES_DEG = (50, -50)
_LOOKOUT_PITCH_DEG = 20
_CANDIDATE_YAWS_DEG = (0, 14, -14, 28, -28, 45, -45, 70, -70)
_CANDIDATE_LOWERS_DEG = (0, -5, 8, 16)
_PITCH_LIMITS_DEG = (8, 35)
_MOST_MISSING = 0.42  # share of a view without a depth; it is penalised from a little less on
_PENALTY_PER_LOWERED_DEG = 0.01
# Between walls the way ahead is the view; in the open the camera turns to what lies there.
_PENALTY_PER_TURNED_DEG = 0.004
_PENALTY_PER_TURNED_DEG_BETWEEN_WALLS = 0.012


@functools.lru_cache(maxsize=2)  # all frames of a moving platform begin at one
def choose_pose(world: SeabedWorld, frame: int, stance: Stance) -> Pose:
    """The pose of a frame: of a few ways to look from its place, the one that shows most.

    A good view has ground to throw shadows on, objects at middle range, something missing but not
    much, and nothing right before the lens.
    """
    eye, heading, pitch, roll = world.path.view(frame)
    least_pitch, most_pitch = _PITCH_LIMITS_DEG  # one candidate at least lies between
    lowers = [
        lower for lower in _CANDIDATE_LOWERS_DEG if least_pitch <= pitch + lower <= most_pitch
    ]
    if stance.altitude_m is not None:
        eye = np.array([*eye[:2], world.terrain.height_m(*eye[:2, None])[0] + stance.altitude_m])
    if stance.tilt_deg is not None:
        pitch = stance.tilt_deg
        roll = 0.0
        lowers = [0]
    per_turned_deg = _PENALTY_PER_TURNED_DEG
    if world.terrain.banks is not None:
        per_turned_deg = _PENALTY_PER_TURNED_DEG_BETWEEN_WALLS

    lookouts = _look_around(world, eye, heading)
    rays = camera(*CALIBRATED_SIZE).directions(np.eye(3), 32).reshape(-1, 3)
    candidates = []
    for yaw in _CANDIDATE_YAWS_DEG:
        for lower in lowers:
            candidate = pose(eye, heading + yaw, pitch + lower, roll)
            view = _view_of(candidate, rays, lookouts)
            penalty = _view_penalty(view, world.look.clear_m, world.first_own)
            penalty += per_turned_deg * abs(yaw) + _PENALTY_PER_LOWERED_DEG * abs(lower)
            candidates.append((penalty, candidate))
    return min(candidates, key=lambda candidate: candidate[0])[1]


class _Lookouts(NamedTuple):
    """What the cameras to the left and to the right see, (H, W) each.

    inverses: one over the depth, 0 where nothing is.  objects: number of the object, 0: none.
    """

    poses: tuple[Pose, ...]
    inverses: tuple[Float32s, ...]
    objects: tuple[Array, ...]


def _look_around(world: SeabedWorld, eye: Float64s, heading: float) -> _Lookouts:
    """Look to both sides over coarse ground ahead and beside, without the fine relief."""
    ranges = np.geomspace(0.15, FARTHEST_M, 72)[:, None]
    azimuths = np.deg2rad(heading) + np.deg2rad(np.linspace(-112, 112, 144))[None]
    x = eye[0] + ranges * np.cos(azimuths)
    y = eye[1] + ranges * np.sin(azimuths)
    ground = np.stack([x, y, world.terrain.height_m(x, y)], axis=-1).astype(np.float32)
    poses = tuple(
        pose(eye, heading + side_deg, _LOOKOUT_PITCH_DEG, 0) for side_deg in _LOOKOUT_SIDES_DEG
    )
    has_instance = world.objects.instances > 0
    clear_m = world.look.clear_m
    buffers = [
        ZBuffer(lookout, _LOOKOUT, world.objects, ground, has_instance, clear_m)
        for lookout in poses
    ]
    inverses = tuple(buffer.inverse for buffer in buffers)
    return _Lookouts(poses, inverses, tuple(buffer.shown[1] for buffer in buffers))


class _RoughView(NamedTuple):
    """What a candidate sees along R rays, (R,) each.

    has_surface: whether a ray meets anything.  object_number: 0 where it meets none.
    """

    depth_m: Float64s
    range_m: Float64s
    has_surface: Bools
    object_number: Array


def _view_of(candidate: Pose, rays: Floats, lookouts: _Lookouts) -> _RoughView:
    """What a camera at the candidate's pose sees, looked up in the images of the lookouts.

    rays: (R, 3) directions of pixels in the camera's axes, 1 along the optical axis.
    """
    fx, fy, cx, cy = _LOOKOUT.lens
    toward = np.einsum("ij,rj->ir", candidate.rotation, rays)
    axes = [np.einsum("ij,ir->jr", lookout.rotation, toward) for lookout in lookouts.poses]
    # The lookout on whose side a ray is: the one that looks more its way.
    is_left = axes[0][2] >= axes[1][2]
    x, y, ahead = np.where(is_left, *axes)
    column = np.clip((x / ahead * fx + cx + 0.5).astype(np.int64), 0, _LOOKOUT.width - 1)
    row = np.clip((y / ahead * fy + cy + 0.5).astype(np.int64), 0, _LOOKOUT.height - 1)
    left_inverse, right_inverse = (plane[row, column] for plane in lookouts.inverses)
    left_object, right_object = (plane[row, column] for plane in lookouts.objects)
    inverse = np.where(is_left, left_inverse, right_inverse)
    object_number = np.where(is_left, left_object, right_object)
    has_surface = inverse * ahead > 0
    depth_m = 1 / np.where(has_surface, inverse * ahead, 1e-9)
    range_m = depth_m * np.sqrt((rays**2).sum(axis=1))
    return _RoughView(depth_m, range_m, has_surface, object_number)


def _view_penalty(view: _RoughView, clear_m: float, first_own: int) -> float:
    """How far a view is from a good one; weights and limits were chosen by looking at views.

    clear_m: range beyond which nothing has a depth.  first_own: number of the user's first object.
    """
    has_object = (view.object_number > 0) & (view.range_m < 0.8 * clear_m)
    shown = np.unique(view.object_number[has_object])
    own_count = np.count_nonzero(shown >= first_own)
    missing_share = (view.range_m > clear_m).mean()
    near_share = (view.depth_m < 0.9).mean()
    object_share = has_object.mean()
    middle_m = 99.0
    if view.has_surface.any():
        middle_m = float(np.median(view.depth_m[view.has_surface]))

    # Up to a third out of sight is fine; none at all is not.
    penalty = 8 * max(missing_share - 0.34, 0) + 60 * max(missing_share - _MOST_MISSING + 0.06, 0)
    penalty += 30 * max(0.03 - missing_share, 0)
    # Little right before the lens, and most at middle range.
    penalty += 12 * max(near_share - 0.02, 0)
    penalty += max(1.4 - middle_m, 0) + 0.4 * max(middle_m - 4, 0)
    # Objects on up to a quarter of the image, of many kinds, one's own first.
    penalty += 4 * max(object_share - 0.42, 0) - min(object_share, 0.25) * 4
    penalty -= 0.05 * min(len(shown), 14)
    return float(penalty) - 1.2 * min(own_count, 2)
