"""The camera of procedural frames and meshes: poses, what pixels meet, boxes around objects.

It has FLSea's field of view, or is as wide as a sonar's sector.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ...common.array_types import Bools, Float32s, Float64s, UInt8s, UInt16s
from ...common.distribution import Distribution
from ...common.errors import FactoryError
from ...common.seeds import stream
from ...common.small_files import number_table
from ..frames.frame import BOX_FIELDS
from .triangle_mesh import Mesh, grid_triangles, join, vertex_normals

FOCAL_PER_WIDTH = 1168.0 / 968.0
"""Focal length of the FLSea camera, which sees 45 degrees across."""
HFOV_DEG = 45.0
VFOV_DEG = 29.2
"""What it sees at 968x608 pixels."""
MOVEMENT = ("surge_m", "sway_m", "heave_m", "roll_deg", "pitch_deg", "yaw_deg")
_MARGIN_DEG = 1.0  # beyond each edge of a sonar's sector
_SIDE_PX = 64  # of the image in which an object's outline is counted
_NEAREST_M = 0.05
WORLD_SEED = 0  # the procedural world is one and the same, a location number a part of it


@dataclass(frozen=True)
class Optics:
    """A pinhole camera without distortion.

    lens: focal lengths and principal point: fx, fy, cx, cy, pixels.
    across: how many times wider than the FLSea camera's its view is, in angle.
    """

    lens: tuple[float, float, float, float]
    width: int
    height: int
    across: float = 1.0

    def directions(self, rotation: Float64s, every: int, border: int = 0) -> Float32s:
        """(H, W, 3) ray directions in world axes whose length along the optical axis is 1.

        every: only every n-th pixel of every n-th row.  border: pixels more, right and below.
        """
        fx, fy, cx, cy = self.lens
        x = ((np.arange(0, self.width + border, every) - cx) / fx)[None, :, None]
        y = ((np.arange(0, self.height + border, every) - cy) / fy)[:, None, None]
        return np.asarray(x * rotation[:, 0] + y * rotation[:, 1] + rotation[:, 2], np.float32)


def centred(focal: float, width: int, height: int, across: float = 1.0) -> Optics:
    """Optics whose principal point is the middle of the image."""
    return Optics((focal, focal, (width - 1) / 2, (height - 1) / 2), width, height, across)


def camera(
    width: int, height: int, hfov_deg: float | None = None, vfov_deg: float | None = None
) -> Optics:
    """The camera whose images are width x height pixels when it sees what FLSea's camera sees.

    hfov_deg, vfov_deg: the sector to see instead, elevation |e| <= vfov_deg / 2 at every azimuth
    |a| <= hfov_deg / 2.  A flat image of it needs tan(e) / cos(a) upwards, so it shows more in
    its corners; pixels are spread so thin that their number grows as the sector's solid angle,
    2 hfov sin(vfov / 2), and no faster.
    """
    if hfov_deg is None or vfov_deg is None:
        return centred(FOCAL_PER_WIDTH * width, width, height)
    azimuth, elevation = np.deg2rad([hfov_deg / 2 + _MARGIN_DEG, vfov_deg / 2 + _MARGIN_DEG])
    half_width = np.tan(azimuth)
    half_height = np.tan(elevation) / np.cos(azimuth)
    pixels = width * height * _solid_angle(hfov_deg, vfov_deg) / _solid_angle(HFOV_DEG, VFOV_DEG)
    focal = float(np.sqrt(pixels / (4 * half_width * half_height)))
    columns, rows = (int(np.ceil(2 * half * focal)) for half in (half_width, half_height))
    return centred(focal, columns, rows, hfov_deg / HFOV_DEG)


def _solid_angle(hfov_deg: float, vfov_deg: float) -> float:
    return float(2 * np.deg2rad(hfov_deg) * np.sin(np.deg2rad(vfov_deg / 2)))


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a camera is and how it is turned: rotation (3, 3) takes camera to world axes."""

    eye: Float64s
    rotation: Float64s

    @property
    def matrix(self) -> Float64s:
        """(4, 4) world from camera."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.eye
        return matrix


class Stance(NamedTuple):
    """What the user says of a camera; None: as the location or path has it.

    altitude_m: above the ground right under it.  tilt_deg: how far it looks down; it is then level
    across.
    """

    altitude_m: float | None = None
    tilt_deg: float | None = None

    @classmethod
    def drawn(
        cls, altitude_m: Distribution | None, tilt_deg: Distribution | None, *names: str | int
    ) -> Stance:
        """The stance that the settings draw under these names; the same names draw the same."""
        return cls(
            None if altitude_m is None else altitude_m.draw(stream(WORLD_SEED, "altitude", *names)),
            None if tilt_deg is None else tilt_deg.draw(stream(WORLD_SEED, "tilt", *names)),
        )


def pose(eye: Float64s, heading_deg: float, pitch_deg: float, roll_deg: float) -> Pose:
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


class Objects:
    """All objects of a location as one mesh.

    owner: (T,) uint16 object number of each triangle.  parts: (N, 4) first point, first triangle
    and the ends of both, of each object.  balls: (N, 4) centre and radius around each.
    labels, instances: (N,) uint8 class, and uint16 number among those that have one, 0 for none.
    """

    def __init__(
        self,
        meshes: Sequence[Mesh],
        labels: UInt8s,
        numbered: Bools | None = None,
    ) -> None:
        """numbered: (N,) which get a number; None: all that have a class."""
        if numbered is None:
            numbered = labels > 0
        self.mesh = join(meshes)
        points = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
        triangles = np.cumsum([0] + [len(mesh.triangles) for mesh in meshes])
        low = np.minimum.reduceat(self.mesh.vertices, points[:-1]).astype(np.float64)
        high = np.maximum.reduceat(self.mesh.vertices, points[:-1]).astype(np.float64)
        radius = np.linalg.norm(high - low, axis=1, keepdims=True) / 2
        self.normals = vertex_normals(self.mesh.vertices, self.mesh.triangles)
        self.owner = np.repeat(np.arange(len(meshes), dtype=np.uint16), np.diff(triangles))
        self.parts = np.stack([points[:-1], triangles[:-1], points[1:], triangles[1:]], axis=-1)
        self.balls = np.concatenate([(low + high) / 2, radius], axis=1)
        self.labels = labels
        self.instances = np.where(numbered, np.cumsum(numbered), 0).astype(np.uint16)


class ZBuffer:
    """What the pixels of a camera meet first.

    ground: (R, C, 3) grid of it; None for none.  wanted: (N,) bool, of the objects; None for all.
    What is further than `reach_m` may be left out.
    inverse: (H, W) float32 one over the depth along the optical axis, 0 where nothing is.
    which: (H, W) int32 number of the triangle, those of the ground first, -1 where nothing is.
    sight: the camera's eye, axes and lens.
    """

    def __init__(
        self,
        viewpoint: Pose,
        optics: Optics,
        objects: Objects,
        ground: Float32s | None = None,
        wanted: Bools | None = None,
        reach_m: float = 1e6,
    ) -> None:
        from .kernels import rasterise_mesh

        self.viewpoint = viewpoint
        self.optics = optics
        self.objects = objects
        self._first_object = 0
        shape = (optics.height, optics.width)
        lens = np.array(optics.lens)
        self.inverse = np.zeros(shape, np.float32)
        self.which = np.full(shape, -1, np.int32)
        self.sight = (viewpoint.eye, viewpoint.rotation, lens)
        planes = (self.inverse, self.which)
        if ground is not None:
            triangles = grid_triangles(*ground.shape[:2])
            points = ground.reshape(-1, 3)
            self._first_object = len(triangles)
            whole = np.array([[0, 0, len(points), len(triangles)]], np.int64)
            rasterise_mesh(points, triangles, whole, 0, self.sight, planes)
        near = self._in_sight(reach_m)
        parts = np.ascontiguousarray(objects.parts[near if wanted is None else wanted & near])
        solid = objects.mesh
        rasterise_mesh(
            solid.vertices, solid.triangles, parts, self._first_object, self.sight, planes
        )

    def _in_sight(self, reach_m: float) -> Bools:
        """(N,) whether the balls around objects touch what the camera sees."""
        viewpoint = self.viewpoint
        radius = self.objects.balls[:, 3]
        ways = (self.objects.balls[:, :3] - viewpoint.eye)[:, None] * viewpoint.rotation.T
        x, y, z = ways.sum(axis=2).T
        fx, fy, cx, cy = self.optics.lens
        right = self.optics.width - 1 - cx
        bottom = self.optics.height - 1 - cy
        in_sight = (z > -radius) & (z < reach_m + radius)
        for offset, slope in ((x, right / fx), (-x, cx / fx), (y, bottom / fy), (-y, cy / fy)):
            in_sight &= offset - slope * z < radius * np.hypot(1, slope)
        return np.asarray(in_sight)

    @property
    def depth_m(self) -> Float32s:
        """(H, W) depth along the optical axis, inf where nothing is."""
        with np.errstate(divide="ignore"):
            return np.asarray(1 / self.inverse)

    @property
    def shown(self) -> tuple[UInt8s, UInt16s]:
        """(H, W) class and instance of the objects, 0 for ground and nothing."""
        numbers = np.append(np.uint16(0), self.objects.owner + np.uint16(1))
        number = numbers.take(np.maximum(self.which - (self._first_object - 1), 0))
        label, instance = (
            np.append(of.dtype.type(0), of) for of in (self.objects.labels, self.objects.instances)
        )
        return label.take(number), instance.take(number)

    def boxes(self, number: UInt16s) -> Float64s:
        """(N, 11) of the instances in a view, whose pixels are `number`; see `Frame.boxes`."""
        rows = []
        objects = self.objects
        for instance in np.unique(number[number > 0]).tolist():
            which = int(np.flatnonzero(objects.instances == instance)[0])
            first, _, last, _ = objects.parts[which]
            points = (
                objects.mesh.vertices[first:last] - self.viewpoint.eye
            ) @ self.viewpoint.rotation
            box = oriented(np.stack([points[:, 2], -points[:, 0], -points[:, 1]], axis=-1))
            rows.append([instance, int(objects.labels[which]), *box, *self._cover(which, points)])
        return np.array(rows, np.float64).reshape(-1, BOX_FIELDS)

    def _cover(self, which: int, points: Float64s) -> tuple[float, float]:
        """Pixels that an object alone would cover, beyond the image too, and those hidden."""
        ahead = points[points[:, 2] > _NEAREST_M]
        if not len(ahead):
            return 0.0, 0.0
        fx, fy, cx, cy = self.optics.lens
        pixels = ahead[:, :2] / ahead[:, 2:] * (fx, fy) + (cx, cy)
        # What reaches beyond the image counts up to one image width or height on each side.
        limits = np.array([self.optics.width, self.optics.height])
        left, top = np.clip(pixels.min(axis=0), -limits, 2 * limits)
        right, bottom = np.clip(pixels.max(axis=0), -limits, 2 * limits)
        step = max((right - left) / _SIDE_PX, (bottom - top) / _SIDE_PX, 0.25)
        lens = fx / step, fy / step, (cx - left) / step, (cy - top) / step
        optics = Optics(lens, int((right - left) / step) + 2, int((bottom - top) / step) + 2)
        wanted = np.arange(len(self.objects.parts)) == which
        alone = ZBuffer(self.viewpoint, optics, self.objects, wanted=wanted).inverse
        rows, columns = np.nonzero(alone)
        near = alone[rows, columns]
        rows, columns = (np.rint(v).astype(int) for v in (top + step * rows, left + step * columns))
        inside = (rows >= 0) & (columns >= 0) & (columns < limits[0]) & (rows < limits[1])
        front = self.inverse[rows[inside], columns[inside]]
        hidden = np.count_nonzero(front > near[inside] * np.float32(1.02))
        return len(near) * step**2, hidden * step**2


def oriented(points: npt.NDArray[np.floating]) -> tuple[float, ...]:
    """Centre (3), length, width, height and yaw (rad) of the box around (V, 3) points, z upright.

    The yaw, to .05 degrees, is that with the least ground: from x to y, of the longer side.
    """
    flat = points[:, :2].astype(np.float64)
    middle = flat.mean(axis=0)
    coarse = _narrowest(flat - middle, np.arange(0.0, 90.0))
    steps_deg = 0.05 * np.arange(-20, 21)
    yaw_deg, extent, centre = _narrowest(flat - middle, coarse.yaw_deg + steps_deg)
    low = float(points[:, 2].min())
    high = float(points[:, 2].max())
    yaw = np.deg2rad((yaw_deg + (0 if extent[0] >= extent[1] else 90) + 90) % 180 - 90)
    x, y = (centre + middle).tolist()
    return x, y, (low + high) / 2, *sorted(extent.tolist(), reverse=True), high - low, float(yaw)


class _Rectangle(NamedTuple):
    """A level rectangle: extent along and across its yaw, (2,), and centre, (2,)."""

    yaw_deg: float
    extent: Float64s
    centre: Float64s


def _narrowest(flat: Float64s, yaws_deg: Float64s) -> _Rectangle:
    """The rectangle of least area around (V, 2) points, of those at the given yaws."""
    cosine = np.cos(np.deg2rad(yaws_deg))
    sine = np.sin(np.deg2rad(yaws_deg))
    axes = np.array([[cosine, -sine], [sine, cosine]])
    turned = np.tensordot(flat, axes, 1)
    least = turned.min(axis=0)
    most = turned.max(axis=0)
    at = int(np.argmin(np.prod(most - least, axis=0)))
    centre = axes[:, :, at] @ (most + least)[:, at] / 2
    return _Rectangle(float(yaws_deg[at]), (most - least)[:, at], centre)


def moved(start: Pose, movement: Mapping[str, float]) -> Pose:
    """The pose of a platform whose recording begins at `start`; `movement`: some of MOVEMENT.

    Surge is forward, sway to the left, heave up (REP 103, level, along the first heading); yaw
    turns left, pitch looks down, roll lowers the right side.
    """
    surge, sway, heave, *turns = (movement.get(name, 0.0) for name in MOVEMENT)
    ahead = start.rotation[:, 2] * (1, 1, 0)
    up = np.array([0.0, 0.0, 1.0])
    ahead /= np.linalg.norm(ahead)
    left = np.array([-ahead[1], ahead[0], 0.0])
    roll, pitch, yaw = np.deg2rad(turns)
    turned = _about(up, yaw) @ start.rotation
    # Pitch about the camera's left, roll about its forward axis.
    turned = _about(-turned[:, 0], pitch) @ turned
    turned = _about(turned[:, 2], roll) @ turned
    return Pose(start.eye + surge * ahead + sway * left + heave * up, turned)


@lru_cache(maxsize=4)
def movements(path: Path) -> tuple[dict[str, float], ...]:
    """The lines of a CSV file: a header of some of MOVEMENT and time_s, then a line a frame.

    Raises FactoryError that names the file and the line.
    """
    table = number_table(path)
    known = ("time_s", *MOVEMENT)
    if not set(table.names) <= set(known) or not table.rows:
        raise FactoryError(
            f"{path}: expected a header of some of {', '.join(known)}, and a line for each frame"
        )
    return tuple(dict(zip(table.names, row, strict=True)) for row in table.rows)


def _about(axis: Float64s, angle_rad: float) -> Float64s:
    """Rotation matrix (3, 3) about a unit axis, right-handed (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross
    return np.asarray(turn)
