"""Which way to look: of a few ways from a place on the path, the one that shows most."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .camera import Optics, Pose, ZBuffer, camera, pose, z_buffer
from .terrain import FAR_M
from .world import World

_EVERY = 32  # pixels of FLSea's camera from one ray to the next
_SIDE_DEG, _DOWN_DEG = 50, 20
# Two such cameras, to the left and to the right, see all that any candidate sees.
_LOOKOUT = Optics(70, 203, 122, 2.2, cy=54)
_OWN = 1.2  # what an object of the user's in sight is worth
_MOST_LOST = 0.42  # share of the pixels without a depth


@lru_cache(maxsize=2)  # all frames of a moving platform begin at one
def choose_pose(world: World, frame: int) -> Pose:
    """The pose of a frame: of a few ways to look from its place, the one that shows most.

    A good view has ground to throw shadows on, objects at middle range, something missing but not
    much, and nothing right before the lens.
    """
    eye = world.path.eye(frame, world.terrain)
    heading, pitch, roll = world.path.attitude_deg(frame)
    # Between walls the way ahead is the view; in the open the camera turns to what lies there.
    turning = 0.012 if world.terrain.banks is not None else 0.004
    candidates, effort = [], []
    for yaw in (0, 14, -14, 28, -28, 45, -45, 70, -70):
        for lower in (0, -5, 8, 16):
            if 8 <= pitch + lower <= 35:  # always includes one
                candidates.append(pose(eye, heading + yaw, pitch + lower, roll))
                effort.append(turning * abs(yaw) + 0.01 * abs(lower))
    ground = _ground_around(world, eye, np.deg2rad(heading))
    wanted = world.objects.instances > 0
    lookouts = [pose(eye, heading + side, _DOWN_DEG, 0) for side in (_SIDE_DEG, -_SIDE_DEG)]
    seen = [
        z_buffer(where, _LOOKOUT, ground, world.objects, wanted, world.look.clear_m)
        for where in lookouts
    ]
    first_object = 2 * (ground.shape[0] - 1) * (ground.shape[1] - 1)
    numbers = np.append(world.objects.instances[world.objects.owner], np.uint16(0))
    things = [numbers[np.where(s.which >= first_object, s.which - first_object, -1)] for s in seen]
    rays = camera(968, 608).directions(np.eye(3), _EVERY).reshape(-1, 3)
    length = np.sqrt((rays**2).sum(axis=1))
    costs = []
    for candidate, extra in zip(candidates, effort, strict=True):
        toward = np.einsum("ij,rj->ir", candidate.rotation, rays)
        *facts, shown = _facts(toward, length, lookouts, seen, things, world.look.clear_m)
        lost, near, middle, share = facts
        own = np.count_nonzero(shown >= world.first_own)
        costs.append(_cost(lost, near, middle, share, len(shown)) + extra - _OWN * min(own, 2))
    return candidates[int(np.argmin(costs))]


def _facts(
    toward: np.ndarray,
    length: np.ndarray,
    lookouts: list[Pose],
    seen: list[ZBuffer],
    things: list[np.ndarray],
    clear_m: float,
) -> tuple[float, float, float, float, np.ndarray]:
    """What rays of a candidate would see, looked up in the pictures of the lookouts.

    toward: (3, R) directions whose length along the candidate's axis is 1.  length: (R,).
    Returns the share of rays beyond `clear_m`, the share nearer than 0.9 m, the median depth, the
    share on objects within 0.8 `clear_m`, and the numbers of those.
    """
    fx, fy, cx, cy = _LOOKOUT.lens
    axes = [np.einsum("ij,ir->jr", where.rotation, toward) for where in lookouts]
    # The lookout on whose side a ray is: the one that looks more its way.
    left = axes[0][2] >= axes[1][2]
    x, y, ahead = (np.where(left, one, other) for one, other in zip(*axes, strict=True))
    column = np.clip((x / ahead * fx + cx + 0.5).astype(np.int64), 0, _LOOKOUT.width - 1)
    row = np.clip((y / ahead * fy + cy + 0.5).astype(np.int64), 0, _LOOKOUT.height - 1)
    inverse = np.where(left, seen[0].inverse[row, column], seen[1].inverse[row, column]) * ahead
    thing = np.where(left, things[0][row, column], things[1][row, column])
    met = inverse > 0
    if not met.any():
        return 1.0, 0.0, 99.0, 0.0, np.empty(0, np.uint16)
    depth = 1 / np.where(met, inverse, 1e-9)
    range_m = depth * length
    named = (thing > 0) & (range_m < 0.8 * clear_m)
    return (
        float((range_m > clear_m).mean()),
        float((depth < 0.9).mean()),
        float(np.median(depth[met])),
        float(named.mean()),
        np.unique(thing[named]),
    )


def _ground_around(world: World, eye: np.ndarray, heading_rad: float) -> np.ndarray:
    """(R, C, 3) coarse ground ahead of and beside an eye, without the fine relief."""
    ranges = np.geomspace(0.15, FAR_M, 72)[:, None]
    azimuths = heading_rad + np.deg2rad(np.linspace(-112, 112, 144))[None]
    x, y = eye[0] + ranges * np.cos(azimuths), eye[1] + ranges * np.sin(azimuths)
    points = np.stack([x, y, world.terrain.height_m(x, y)], axis=-1)
    return np.ascontiguousarray(points, dtype=np.float32)


def _cost(lost: float, too_near: float, middle: float, share: float, variety: int) -> float:
    """How bad a view is; arguments as `_facts` returns them."""
    cost = (
        8 * max(lost - 0.34, 0) + 60 * max(lost - _MOST_LOST + 0.06, 0) + 30 * max(0.03 - lost, 0)
    )
    cost += 12 * max(too_near - 0.02, 0) + max(1.4 - middle, 0) + 0.4 * max(middle - 4, 0)
    return cost + 4 * max(share - 0.42, 0) - min(share, 0.25) * 4 - 0.05 * min(variety, 14)
