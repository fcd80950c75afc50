"""Which way to look: of a few ways from a place on the path, the one that shows most."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from ...frame import Intrinsics
from .depth_dropout import MOST_LOST
from .optics import Optics, camera
from .rasterizer import Pose, lens_of, pose, z_buffer
from .terrain import FAR_M

if TYPE_CHECKING:
    from .world import World

_EVERY = 16  # pixels of FLSea's camera from one ray to the next
_SIDE_DEG, _DOWN_DEG = 50, 20
# Two such cameras, to the left and to the right, see all that any candidate sees.
_LOOKOUT = Optics(Intrinsics(70, 70, 101, 54), 203, 122, 2.2)


@lru_cache(maxsize=2)  # all frames of a moving platform begin at one
def choose_pose(world: World, frame: int) -> Pose:
    """The pose of a frame: of a few ways to look from its place, the one that shows most.

    A good view has ground to throw shadows on, objects at middle range, something missing but not
    much, and nothing right before the lens.
    """
    from .loops.viewpoint_loops import judge

    eye = world.path.eye(frame, world.terrain)
    heading, pitch, roll = world.path.attitude_deg(frame)
    # Between walls the way ahead is the view; in the open the camera turns to what lies there.
    turning = 0.012 if world.terrain.banks is not None else 0.004
    candidates, effort = [], []
    for yaw in (0, 14, -14, 28, -28, 45, -45, 70, -70):
        for lower in (0, 5, -5, 10, 16):
            if 8 <= pitch + lower <= 35:  # always includes one
                candidates.append(pose(eye, heading + yaw, pitch + lower, roll))
                effort.append(turning * abs(yaw) + 0.01 * abs(lower))
    ground = _ground_around(world, eye, np.deg2rad(heading))
    wanted = world.instances > 0
    lookouts = [pose(eye, heading + side, _DOWN_DEG, 0) for side in (_SIDE_DEG, -_SIDE_DEG)]
    seen = [
        z_buffer(where, _LOOKOUT, ground, world.objects, wanted, 2 * world.water.clear_m)
        for where in lookouts
    ]
    first_object = 2 * (ground.shape[0] - 1) * (ground.shape[1] - 1)
    numbers = np.append(world.instances[world.objects.owner], np.uint16(0))
    things = [np.where(s.which >= first_object, s.which - first_object, -1) for s in seen]
    optics = camera(968, 608)
    facts = np.empty((len(candidates), 5))
    judge(
        np.stack([c.rotation for c in candidates]), lens_of(optics), optics.width, optics.height,
        _EVERY, np.stack([where.rotation for where in lookouts]), lens_of(_LOOKOUT),
        np.stack([s.inverse for s in seen]), np.stack([numbers[t] for t in things]),
        world.water.clear_m, facts,
    )  # fmt: skip
    costs = _cost(*facts.T) + effort
    return candidates[int(np.argmin(costs))]


def _ground_around(world: World, eye: np.ndarray, heading_rad: float) -> np.ndarray:
    """(R, C, 3) coarse ground ahead of and beside an eye, without the fine relief."""
    ranges = np.geomspace(0.15, FAR_M, 72)[:, None]
    azimuths = heading_rad + np.deg2rad(np.linspace(-112, 112, 144))[None]
    x, y = eye[0] + ranges * np.cos(azimuths), eye[1] + ranges * np.sin(azimuths)
    points = np.stack([x, y, world.terrain.height_m(x, y)], axis=-1)
    return np.ascontiguousarray(points, dtype=np.float32)


def _cost(
    lost: np.ndarray,
    too_near: np.ndarray,
    middle: np.ndarray,
    share: np.ndarray,
    variety: np.ndarray,
) -> np.ndarray:
    """How bad views are; arguments as `judge` writes them, (N,) each."""

    def over(values: np.ndarray) -> np.ndarray:
        return np.maximum(values, 0)

    cost = 8 * over(lost - 0.34) + 60 * over(lost - MOST_LOST + 0.06) + 30 * over(0.03 - lost)
    cost += 12 * over(too_near - 0.02) + over(1.4 - middle) + 0.4 * over(middle - 4)
    cost += 4 * over(share - 0.42) - np.minimum(share, 0.25) * 4 - 0.05 * np.minimum(variety, 14)
    return np.asarray(cost)
