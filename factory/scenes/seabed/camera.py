"""The camera of procedural frames, its poses, and what its pixels meet.

It has FLSea's field of view, or is as wide as a sonar's sector.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from ...frame import Intrinsics
from .fields import Floats
from .meshes import Mesh, grid_triangles, join, vertex_normals

Points = npt.NDArray[np.float64]

FOCAL_PER_WIDTH = 1168.0 / 968.0
"""Of the FLSea camera, which sees 45 degrees across."""
HFOV_DEG, VFOV_DEG = 45.0, 29.2
"""What it sees at 968x608 pixels."""
_MARGIN_DEG = 1.0  # beyond each edge of a sonar's sector


@dataclass(frozen=True)
class Optics:
    """A pinhole camera without distortion.

    across: how many times wider than the FLSea camera's its view is, in angle.
    cy: row of the principal point, None in the middle.
    """

    focal: float
    width: int
    height: int
    across: float = 1.0
    cy: float | None = None

    @property
    def intrinsics(self) -> Intrinsics:
        """In pixels."""
        cy = (self.height - 1) / 2 if self.cy is None else self.cy
        return Intrinsics(self.focal, self.focal, (self.width - 1) / 2, cy)

    @property
    def lens(self) -> Points:
        """(4,) focal lengths and principal point, pixels."""
        camera = self.intrinsics
        return np.array([camera.fx, camera.fy, camera.cx, camera.cy])

    def directions(self, rotation: Points, every: int = 1, border: int = 0) -> Floats:
        """(H, W, 3) ray directions in world axes whose length along the optical axis is 1.

        every: only each such pixel of each such row.  border: so many pixels more, right and below.
        """
        fx, fy, cx, cy = self.lens
        x = ((np.arange(0, self.width + border, every) - cx) / fx)[None, :, None]
        y = ((np.arange(0, self.height + border, every) - cy) / fy)[:, None, None]
        return np.asarray(x * rotation[:, 0] + y * rotation[:, 1] + rotation[:, 2], np.float32)


def camera(
    width: int, height: int, hfov_deg: float | None = None, vfov_deg: float | None = None
) -> Optics:
    """The camera whose pictures are width x height pixels when it sees what FLSea's camera sees.

    hfov_deg, vfov_deg: the sector to see instead, elevation |e| <= vfov_deg / 2 at every azimuth
    |a| <= hfov_deg / 2.  A flat picture of it needs tan(e) / cos(a) upwards, so it shows more in
    its corners; pixels are spread so thin that their number grows as the sector's solid angle,
    2 hfov sin(vfov / 2), and no faster.
    """
    if hfov_deg is None or vfov_deg is None:
        return Optics(FOCAL_PER_WIDTH * width, width, height)
    azimuth = np.deg2rad(hfov_deg / 2 + _MARGIN_DEG)
    elevation = np.deg2rad(vfov_deg / 2 + _MARGIN_DEG)
    half_width = np.tan(azimuth)
    half_height = np.tan(elevation) / np.cos(azimuth)
    pixels = width * height * _solid_angle(hfov_deg, vfov_deg) / _solid_angle(HFOV_DEG, VFOV_DEG)
    focal = float(np.sqrt(pixels / (4 * half_width * half_height)))
    columns, rows = (int(np.ceil(2 * half * focal)) for half in (half_width, half_height))
    return Optics(focal, columns, rows, hfov_deg / HFOV_DEG)


def _solid_angle(hfov_deg: float, vfov_deg: float) -> float:
    return float(2 * np.deg2rad(hfov_deg) * np.sin(np.deg2rad(vfov_deg / 2)))


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


@dataclass(frozen=True, eq=False)
class Objects:
    """All objects of a location as one mesh.

    owner: (T,) object number of each triangle.  parts: (N, 4) first point, first triangle and the
    ends of both, of each object.  balls: (N, 4) centre and radius around each.  labels, instances:
    (N,) class, and number among those that have one, 0 for none.
    """

    mesh: Mesh
    normals: Floats
    owner: npt.NDArray[np.uint16]
    parts: npt.NDArray[np.int64]
    balls: Points
    labels: npt.NDArray[np.uint8]
    instances: npt.NDArray[np.uint16]

    def shown(
        self, number: npt.NDArray[Any]
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint16]]:
        """Class and instance of each object number, of which the first is 1 and 0 is none."""
        label, instance = (np.append(of.dtype.type(0), of) for of in (self.labels, self.instances))
        return label.take(number), instance.take(number)


def objects_of(meshes: Sequence[Mesh], labels: npt.NDArray[np.uint8]) -> Objects:
    """Join the objects of a location, whose classes are `labels`."""
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
        parts=np.stack([points[:-1], triangles[:-1], points[1:], triangles[1:]], axis=-1),
        balls=np.concatenate([(low + high) / 2, radius], axis=1),
        labels=labels,
        instances=np.where(labels > 0, np.cumsum(labels > 0), 0).astype(np.uint16),
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
    ground: Floats | None,
    objects: Objects,
    wanted: npt.NDArray[np.bool_] | None = None,
    reach_m: float = 1e6,
) -> ZBuffer:
    """Paint the (R, C, 3) grid of the ground and the wanted objects, no further than `reach_m`.

    ground: None for none.  wanted: (N,); None for all objects.
    """
    from .kernels import paint

    shape, lens, first_object = (optics.height, optics.width), optics.lens, 0
    seen = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
    sight = where.eye, where.rotation, lens
    if ground is not None:
        triangles = grid_triangles(*ground.shape[:2])
        first_object = len(triangles)
        whole = np.array([[0, 0, ground.shape[0] * ground.shape[1], first_object]], np.int64)
        paint(ground.reshape(-1, 3), triangles, whole, 0, sight, seen)
    near = _in_sight(where, lens, shape, objects.balls, reach_m)
    parts = np.ascontiguousarray(objects.parts[near if wanted is None else wanted & near])
    paint(objects.mesh.vertices, objects.mesh.triangles, parts, first_object, sight, seen)
    return ZBuffer(*seen)


def _in_sight(
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
