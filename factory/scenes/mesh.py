"""The `mesh` reader: a whole world of the user's, along recorded poses or a drawn path.

What a pixel meets is what a ray through its centre meets first, found by the z-buffer of the
procedural scenes: exact, and a tenth of the time of tracing as many rays.
"""

from __future__ import annotations

import re
from dataclasses import dataclass as plain_dataclass
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from ..errors import FactoryError, FrameError
from ..frame import Frame, FrameRef, checked
from ..labels import class_names
from ..seeds import stream
from ..settings import STRICT
from .base import Discovery, OwnClass, Root, SceneSettings

if TYPE_CHECKING:
    from .seabed.camera import Objects, Optics, Pose

_LARGEST_M = 3000.0
_KEY = "scenes.file"
_GROUND_PX = 9  # side of the picture that looks for the ground below
_CLEAR_M = 0.3
Span = tuple[float, float]
Points = npt.NDArray[np.float64]


@dataclass(frozen=True, config=ConfigDict(**STRICT, serialize_by_alias=True), kw_only=True)
class PartClass(OwnClass):
    """An entry of `scenes.classes`.  parts: name of its parts in the file, or a pattern."""

    parts: str


@dataclass(frozen=True, config=STRICT, kw_only=True)
class MeshSettings(SceneSettings):
    """Keys of `scenes=mesh`.

    file: .glb, .gltf, .obj, .ply, .stl, or .blend (whose pictures Cycles makes with its own
        materials); z (of .glb: y) points up.  scale: metres per unit of the file.
    classes: see `PartClass`; other parts are Background.
    poses: a file of `time tx ty tz qx qy qz qw` lines (TUM; commas go, too): camera to world in
        metres, camera axes x right, y down, z forward; null: drawn paths.
    route: orbit (around a named part, or all) or transect (straight over the world).
    paths, views_per_path: how many paths, each a scene, and views of each, a second apart.
    height_m: least and most above the ground right under the camera.  distance_m: of an orbit.
    tilt_deg: how far a transect looks down.  speed_m_s: of the camera.
    width, height, hfov_deg, vfov_deg: of the camera, as of `scenes=seabed`.
    """

    kind: Literal["mesh"] = "mesh"
    depth_kind: Literal["z"] = "z"
    file: Root
    scale: Annotated[float, Field(gt=0)] = 1.0
    classes: tuple[PartClass, ...] = ()
    poses: Root | None = None
    route: Literal["orbit", "transect"] = "orbit"
    paths: Annotated[int, Field(ge=1, le=9999)] = 4
    views_per_path: Annotated[int, Field(ge=1, le=9999)] = 25
    height_m: Span = (1.0, 2.0)
    distance_m: Span = (2.0, 4.0)
    tilt_deg: Span = (20.0, 35.0)
    speed_m_s: Annotated[float, Field(gt=0)] = 0.5
    width: Annotated[int, Field(ge=64, le=4096)] = 968
    height: Annotated[int, Field(ge=48, le=4096)] = 608
    hfov_deg: Annotated[float, Field(gt=0, le=150)] | None = None
    vfov_deg: Annotated[float, Field(gt=0, le=60)] | None = None

    def own(self) -> tuple[OwnClass, ...]:
        """See `SceneSettings`."""
        return self.classes


@plain_dataclass(frozen=True, eq=False)
class _World:
    """objects: the parts.  labels, instances: (N,) by part.  shades: (T, 3) uint8 of each face."""

    objects: Objects
    labels: npt.NDArray[np.uint8]
    instances: npt.NDArray[np.uint16]
    shades: npt.NDArray[np.uint8]


class MeshReader:
    """Takes frames of one world; its name and the settings decide them."""

    def __init__(self, settings: MeshSettings) -> None:
        """Nothing is read before it is needed."""
        self._settings = settings
        self._path = Path(settings.file).expanduser()

    def discover(self) -> Discovery:
        """List the frames: scene `orbit-0003` is the path number 3, frame `0007` its view 7."""
        from .mesh_parts import files_of

        settings = self._settings
        paths, name = files_of(self._path, _KEY), self._path.stem
        assert self._world.objects is not None  # read, so that bad files show here
        if settings.poses is not None:
            poses = str(Path(settings.poses).expanduser())
            places = [("poses", k) for k in range(len(self._poses[0]))]
            paths += (poses,)
        else:
            each = range(settings.views_per_path)
            places = [
                (f"{settings.route}-{path:04d}", k) for path in range(settings.paths) for k in each
            ]
        return Discovery(tuple(FrameRef(name, scene, f"{k:04d}", paths) for scene, k in places))

    def load(self, ref: FrameRef) -> Frame:
        """See `Reader`."""
        from .boxes import boxes_of
        from .seabed.camera import camera, z_buffer

        settings, world = self._settings, self._world
        found = re.fullmatch(r"(poses|(?:orbit|transect)-(\d{4}))", ref.scene)
        if found is None or not ref.frame.isdecimal():
            raise FrameError(f"{ref.name}: no view of this world; names are like orbit-0003/0007")
        optics = camera(settings.width, settings.height, settings.hfov_deg, settings.vfov_deg)
        where, time_s, altitude_m = self._pose(int(found[2] or -1), int(ref.frame))
        seen = z_buffer(where, optics, None, world.objects)
        face = np.maximum(seen.which, 0)
        part = np.where(seen.which < 0, 0, world.objects.owner[face] + np.int64(1))
        instance = np.append(np.uint16(0), world.instances)[part]
        with np.errstate(divide="ignore"):
            depth_m = np.where(seen.inverse > 0, 1 / seen.inverse, np.float32(0))
        frame = Frame(
            ref=ref,
            rgb=self._photograph(where, optics, face, seen.which < 0),
            depth_m=np.asarray(depth_m, np.float32),
            intrinsics=optics.intrinsics,
            world_from_camera=where.matrix,
            segmentation=np.append(np.uint8(0), world.labels)[part],
            instance=instance,
            time_s=time_s,
            altitude_m=altitude_m,
            boxes=boxes_of(
                where, optics, world.objects, world.labels, world.instances, seen, instance
            ),
        )
        return checked(frame, bad_depth=settings.bad_depth)

    @cached_property
    def _world(self) -> _World:
        from .mesh_parts import read_parts
        from .seabed.camera import objects_of

        settings = self._settings
        parts = read_parts(self._path, _KEY, settings.scale, _LARGEST_M)
        names = class_names(settings.own_classes())
        labels = np.zeros(len(parts), np.uint8)
        for one in settings.classes:
            meant = [k for k, part in enumerate(parts) if fnmatchcase(part.name, one.parts)]
            if not meant:
                known = ", ".join(sorted({part.name for part in parts}))[:200]
                raise FactoryError(
                    f"scenes.classes: no part is called {one.parts}; there are {known}"
                )
            labels[meant] = names.index(one.label)
        objects = objects_of([part.mesh for part in parts])
        corners = objects.mesh.vertices[objects.mesh.triangles]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        up = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-20)
        light = (0.65 + 0.35 * up)[:, None]  # from above, through water
        albedo = objects.mesh.colours[objects.mesh.triangles].mean(axis=1)
        shades = np.round(255 * np.clip(albedo * light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
        numbers = np.where(labels > 0, np.cumsum(labels > 0), 0).astype(np.uint16)
        return _World(objects, labels, numbers, shades)

    def _photograph(
        self, where: Pose, optics: Optics, face: npt.NDArray[np.int32], empty: npt.NDArray[np.bool_]
    ) -> npt.NDArray[np.uint8]:
        if self._path.suffix.lower() != ".blend":
            rgb = self._world.shades[face]
            rgb[empty] = 0
            return rgb
        import cv2

        from . import blend
        from .mesh_parts import reading_process

        matrix = where.matrix
        matrix[:3, 3] /= self._settings.scale
        lens, size = optics.lens.tolist(), (optics.width, optics.height)
        process, given = reading_process(), (self._path, matrix.tolist(), lens, *size)
        content = process.call(blend.photograph, *given, limit_s=600.0)
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        return np.ascontiguousarray(picture[..., ::-1])

    @cached_property
    def _poses(self) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        from .tum import trajectory

        assert self._settings.poses is not None
        return trajectory(Path(self._settings.poses).expanduser())

    def _pose(self, path: int, view: int) -> tuple[Pose, float, float | None]:
        """Pose, time and height above the ground of a view."""
        from .seabed.camera import Pose

        if path < 0:
            times, poses = self._poses
            if view >= len(times):
                raise FrameError(f"scenes.poses={self._settings.poses}: has no line {view + 1}")
            matrix = poses[view]
            where = Pose(matrix[:3, 3].copy(), np.ascontiguousarray(matrix[:3, :3]))
            return where, float(times[view]), self._above_ground_m(where.eye)
        return self._drawn(path, view)

    def _drawn(self, path: int, view: int) -> tuple[Pose, float, float | None]:
        from .seabed.camera import pose

        settings, objects = self._settings, self._world.objects
        rng = stream(0, "mesh", settings.route, path)
        targets = np.flatnonzero(self._world.labels)
        target = int(rng.choice(targets)) if len(targets) else None
        points = objects.mesh.vertices
        if target is not None:
            points = points[objects.parts[target, 0] : objects.parts[target, 2]]
        low, high = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
        centre, travelled = (low + high) / 2, settings.speed_m_s * view
        height_m, heading = rng.uniform(*settings.height_m), rng.uniform(0, 2 * np.pi)
        if settings.route == "orbit":
            distance_m, side = rng.uniform(*settings.distance_m), rng.choice([-1, 1])
            distance_m += float(np.hypot(*(high - low)[:2])) / 2 * (target is not None)
            angle = heading + side * travelled / distance_m
            turns = np.linspace(0, 2 * np.pi, 9)[1:, None]
            ring = centre + distance_m * np.hstack([np.cos(turns), np.sin(turns), 0 * turns])
            eye = centre + distance_m * np.array([np.cos(angle), np.sin(angle), 0])
            eye = self._raised(eye, height_m, ring)
            heading, down = angle + np.pi, np.arctan2(eye[2] - centre[2], distance_m)
        else:
            aside = rng.uniform(-0.25, 0.25) * np.hypot(*(high - low)[:2])
            ahead = np.array([np.cos(heading), np.sin(heading), 0])
            reach = float(np.hypot(*(high - low)[:2])) / 2
            start = travelled - reach
            left = np.array([-ahead[1], ahead[0], 0])
            line = centre + np.linspace(-1, 1, 9)[:, None] * ahead * reach + aside * left
            eye = self._raised(centre + start * ahead + aside * left, height_m, line)
            down = np.deg2rad(rng.uniform(*settings.tilt_deg))
        where = pose(eye, float(np.rad2deg(heading)), float(np.rad2deg(down)), 0.0)
        return where, float(view), self._above_ground_m(eye)

    def _raised(self, point: Points, height_m: float, path: Points) -> Points:
        """The point so high above the middle height of the ground under a path.

        path: (N, 3).  It is clear of what lies under itself, and above itself without any ground.
        """
        top = float(self._world.objects.mesh.vertices[:, 2].max()) + 1
        below = [self._above_ground_m(np.array([x, y, top])) for x, y, _ in (point, *path)]
        known = [top - one for one in below[1:] if one is not None]
        level = (float(np.median(known)) if known else float(point[2])) + height_m
        clear = level if below[0] is None else max(level, top - below[0] + _CLEAR_M)
        return np.array([*point[:2], clear])

    def _above_ground_m(self, eye: Points) -> float | None:
        from .seabed.camera import Optics, pose, z_buffer

        down = z_buffer(pose(eye, 0, 90, 0), Optics(500, _GROUND_PX, _GROUND_PX), None,
                        self._world.objects)  # fmt: skip
        nearest = down.inverse[_GROUND_PX // 2, _GROUND_PX // 2]
        return float(1 / nearest) if nearest > 0 else None
