"""What a camera meets: poses, the objects of a location in one mesh, and the pixels of a view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...frame import Intrinsics
from .fields import Floats
from .meshes import Mesh, grid_triangles, join, vertex_normals
from .optics import Optics

Points = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a camera is and how it is turned: rotation (3, 3) takes camera to world axes."""

    eye: Points
    rotation: Points

    @property
    def matrix(self) -> Points:
        """(4, 4) world from camera."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.eye
        return matrix


def pose(eye: Points, heading_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
    """A camera that looks along a heading (counter-clockwise from +x), pitched down, rolled."""
    heading, pitch, roll = np.deg2rad([heading_deg, pitch_deg, roll_deg])
    level = np.array([np.cos(heading), np.sin(heading), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    forward = np.cos(pitch) * level - np.sin(pitch) * up
    down = -np.sin(pitch) * level - np.cos(pitch) * up
    right = np.array([np.sin(heading), -np.cos(heading), 0.0])
    x = np.cos(roll) * right + np.sin(roll) * down
    y = -np.sin(roll) * right + np.cos(roll) * down
    rotation = np.ascontiguousarray(np.stack([x, y, forward], axis=-1))
    return Pose(np.asarray(eye, dtype=np.float64), rotation)


def directions(
    rotation: Points, intrinsics: Intrinsics, width: int, height: int, every: int = 1
) -> Floats:
    """(H, W, 3) ray directions in world axes whose length along the optical axis is 1.

    every: only each such pixel of each such row.
    """
    x = ((np.arange(0, width, every) - intrinsics.cx) / intrinsics.fx)[None, :, None]
    y = ((np.arange(0, height, every) - intrinsics.cy) / intrinsics.fy)[:, None, None]
    return np.asarray(x * rotation[:, 0] + y * rotation[:, 1] + rotation[:, 2], dtype=np.float32)


@dataclass(frozen=True, eq=False)
class Objects:
    """All objects of a location as one mesh.

    owner: (T,) object number of each triangle.  first_point, first_triangle: (N + 1,) where those
    of an object begin.  balls: (N, 4) centre and radius around each.
    """

    mesh: Mesh
    normals: Floats
    owner: npt.NDArray[np.uint16]
    first_point: npt.NDArray[np.int64]
    first_triangle: npt.NDArray[np.int64]
    balls: Points

    def parts(self, wanted: npt.NDArray[np.bool_]) -> npt.NDArray[np.int64]:
        """(K, 4) first point, first triangle and the ends of both, of the wanted objects."""
        points, triangles = self.first_point, self.first_triangle
        columns = (points[:-1], triangles[:-1], points[1:], triangles[1:])
        return np.ascontiguousarray(np.stack(columns, axis=-1)[wanted])


def objects_of(meshes: Sequence[Mesh]) -> Objects:
    """Join the objects of a location."""
    whole = join(meshes)
    points = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    triangles = np.cumsum([0] + [len(mesh.triangles) for mesh in meshes])
    low = np.minimum.reduceat(whole.vertices, points[:-1]).astype(np.float64)
    high = np.maximum.reduceat(whole.vertices, points[:-1]).astype(np.float64)
    radius = np.linalg.norm(high - low, axis=1, keepdims=True) / 2
    return Objects(
        mesh=whole,
        normals=vertex_normals(whole.vertices, whole.triangles),
        owner=np.repeat(np.arange(len(meshes), dtype=np.uint16), np.diff(triangles)),
        first_point=points.astype(np.int64),
        first_triangle=triangles.astype(np.int64),
        balls=np.concatenate([(low + high) / 2, radius], axis=1),
    )


@dataclass(frozen=True, eq=False)
class ZBuffer:
    """What the pixels of a camera meet first.

    inverse: (H, W) one over the depth along the optical axis, 0 where nothing is.  which: (H, W)
    number of the triangle, those of the ground first, -1 where nothing is.
    """

    inverse: Floats
    which: npt.NDArray[np.int32]

    @property
    def depth_m(self) -> Floats:
        """(H, W) depth along the optical axis, inf where nothing is."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / self.inverse)


def z_buffer(
    where: Pose,
    optics: Optics,
    ground: Floats,
    objects: Objects,
    wanted: npt.NDArray[np.bool_],
    reach_m: float = 1e6,
) -> ZBuffer:
    """Paint the (R, C, 3) grid of the ground and the wanted objects, no further than `reach_m`."""
    from .kernels import paint

    rows, columns = ground.shape[:2]
    lens = lens_of(optics)
    inverse = np.zeros((optics.height, optics.width), dtype=np.float32)
    which = np.full((optics.height, optics.width), -1, dtype=np.int32)
    camera = where.eye, where.rotation, lens, inverse, which
    triangles = grid_triangles(rows, columns)
    whole = np.array([[0, 0, rows * columns, len(triangles)]], dtype=np.int64)
    paint(ground.reshape(-1, 3), triangles, whole, 0, *camera)
    near = in_sight(where, lens, which.shape, objects.balls, reach_m)
    parts = objects.parts(wanted & near)
    paint(objects.mesh.vertices, objects.mesh.triangles, parts, len(triangles), *camera)
    return ZBuffer(inverse, which)


def in_sight(
    where: Pose, lens: Points, shape: tuple[int, ...], balls: Points, reach_m: float
) -> npt.NDArray[np.bool_]:
    """(N,) whether balls touch what a camera of this picture (H, W) sees within `reach_m`."""
    x, y, z = ((balls[:, :3] - where.eye)[:, None] * where.rotation.T).sum(axis=2).T
    radius = balls[:, 3]
    fx, fy, cx, cy = lens
    seen = (z > -radius) & (z < reach_m + radius)
    for offset, slope in ((x, (shape[1] - 1 - cx) / fx), (-x, cx / fx),
                          (y, (shape[0] - 1 - cy) / fy), (-y, cy / fy)):  # fmt: skip
        seen &= offset - slope * z < radius * np.hypot(1, slope)
    return np.asarray(seen)


def lens_of(optics: Optics) -> Points:
    """(4,) focal lengths and principal point, pixels."""
    camera = optics.intrinsics
    return np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float64)
