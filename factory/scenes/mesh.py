"""The `mesh` reader: a whole world of the user's, along recorded poses or a drawn path.

What a pixel meets is what a ray through its centre meets first, found by the z-buffer of the
procedural scenes: exact, and a tenth of the time of tracing as many rays.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable
from fnmatch import fnmatchcase
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from ..errors import FactoryError
from ..frame import Frame, FrameRef, Intrinsics, checked
from ..labels import class_names
from ..seeds import stream
from ..settings import STRICT
from .base import Discovery, OwnClass, Root, SceneSettings, numbered_lines, numbers_in
from .mesh_parts import READING, files_of, photograph, read_parts, turned_note
from .seabed.camera import Objects, Optics, Pose, ZBuffer, camera, centred, pose

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
    width, height, hfov_deg, vfov_deg: of the camera; these, boxes, camera_altitude_m and
        camera_tilt_deg as of `scenes=seabed`; the latter are of drawn paths.
    """

    kind: Literal["mesh"] = "mesh"
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
    boxes: bool = False
    camera_altitude_m: Annotated[float, Field(gt=0)] | None = None
    camera_tilt_deg: Annotated[float, Field(ge=-90, le=90)] | None = None

    def own(self) -> tuple[OwnClass, ...]:
        """See `SceneSettings`."""
        return self.classes


class MeshReader:
    """Takes frames of one world; its name and the settings decide them."""

    def __init__(self, settings: MeshSettings) -> None:
        """Nothing is read before it is needed."""
        self._settings = settings
        self._path = Path(settings.file).expanduser()
        self._course = cache(self._drawn)

    def discover(self) -> Discovery:
        """List the frames: scene `orbit-0003` is the path number 3, frame `0007` its view 7."""
        settings = self._settings
        paths, views = files_of(self._path, _KEY), settings.views_per_path
        scenes = [f"{settings.route}-{path:04d}" for path in range(settings.paths)]
        _, _, notes = self._world  # read, so that bad files show here
        if settings.poses is not None:
            recorded = Path(settings.poses).expanduser()
            scenes, views = ["poses"], len(trajectory(recorded)[0])
            paths += (str(recorded),)
        places = itertools.product(scenes, range(views))
        refs = (FrameRef(self._path.stem, scene, f"{view:04d}", paths) for scene, view in places)
        return Discovery(tuple(refs), notes=notes)

    def load(self, ref: FrameRef) -> Frame:
        """See `Reader`."""
        settings, (objects, shades, _) = self._settings, self._world
        optics = camera(settings.width, settings.height, settings.hfov_deg, settings.vfov_deg)
        view, time_s = int(ref.frame), float(ref.frame)
        if settings.poses is not None:
            times, poses = trajectory(Path(settings.poses).expanduser())
            time_s, matrix = float(times[view]), poses[view]
            where = Pose(matrix[:3, 3].copy(), np.ascontiguousarray(matrix[:3, :3]))
        else:
            where = self._course(int(ref.scene[-4:]))(settings.speed_m_s * view)
        seen = ZBuffer(where, optics, objects)
        segmentation, instance = seen.shown
        frame = Frame(
            ref=ref,
            rgb=self._photograph(where, optics, shades[seen.which]),
            depth_m=np.where(seen.which < 0, np.float32(0), seen.depth_m),
            intrinsics=Intrinsics(*optics.lens),
            world_from_camera=where.matrix,
            segmentation=segmentation,
            instance=instance,
            time_s=time_s,
            altitude_m=self._below(where.eye),
            boxes=seen.boxes(instance) if settings.boxes else None,
        )
        return checked(frame)

    @cached_property
    def _world(self) -> tuple[Objects, npt.NDArray[np.uint8], tuple[str, ...]]:
        """The parts, shades (T + 1, 3) of their faces and of nothing, and notes for the user."""
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
        objects = Objects([part.mesh for part in parts], labels)
        a, b, c = objects.mesh.vertices[objects.mesh.triangles].transpose(1, 0, 2)
        normal = np.cross(b - a, c - a)
        up = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-20)
        light = (0.65 + 0.35 * up)[:, None]  # from above, through water
        albedo = objects.mesh.colours[objects.mesh.triangles].mean(axis=1)
        shades = np.round(255 * np.clip(albedo * light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
        shades = np.append(shades, np.zeros((1, 3), np.uint8), axis=0)
        return objects, shades, turned_note(self._path, parts)

    def _photograph(
        self, where: Pose, optics: Optics, shaded: npt.NDArray[np.uint8]
    ) -> npt.NDArray[np.uint8]:
        if self._path.suffix.lower() != ".blend":
            return shaded
        from PIL import Image

        matrix = where.matrix
        matrix[:3, 3] /= self._settings.scale
        given = matrix.tolist(), list(optics.lens), optics.width, optics.height
        content = READING.call(photograph, self._path, *given, limit_s=600.0)
        with Image.open(io.BytesIO(content)) as picture:
            return np.array(picture.convert("RGB"))

    def _drawn(self, path: int) -> Callable[[float], Pose]:
        """Draw a path, and measure the ground under it; metres travelled give the pose."""
        settings, objects = self._settings, self._world[0]
        rng = stream(0, "mesh", settings.route, path)
        targets = np.flatnonzero(objects.labels)
        points = objects.mesh.vertices
        if len(targets):
            first, _, last, _ = objects.parts[rng.choice(targets)]
            points = points[first:last]
        low, high = points.min(axis=0).astype(float), points.max(axis=0).astype(float)
        centre, reach_m = (low + high) / 2, float(np.hypot(*(high - low)[:2])) / 2
        height_m, heading = rng.uniform(*settings.height_m), rng.uniform(0, 2 * np.pi)
        if settings.route == "orbit":
            distance_m, side = rng.uniform(*settings.distance_m), rng.choice([-1, 1])
            distance_m += reach_m * (len(targets) > 0)
            under = centre + distance_m * _level(np.linspace(0, 2 * np.pi, 9)[1:])
        else:
            aside_m = 2 * rng.uniform(-0.25, 0.25) * reach_m
            ahead, aside = _level(heading), aside_m * _level(heading + np.pi / 2)
            under = centre + np.linspace(-1, 1, 9)[:, None] * ahead * reach_m + aside
            tilt = np.deg2rad(rng.uniform(*settings.tilt_deg))
        known = [one for one in map(self._ground_m, under) if one is not None]
        level_m = (float(np.median(known)) if known else float(centre[2])) + height_m

        def orbit(travelled_m: float) -> Pose:
            angle = heading + travelled_m / (side * distance_m)
            eye = self._clear(centre + distance_m * _level(angle), level_m)
            down_deg = np.rad2deg(np.arctan2(eye[2] - centre[2], distance_m))
            return self._standing(eye, float(np.rad2deg(angle + np.pi)), float(down_deg))

        def transect(travelled_m: float) -> Pose:
            eye = self._clear(centre + (travelled_m - reach_m) * ahead + aside, level_m)
            return self._standing(eye, float(np.rad2deg(heading)), float(np.rad2deg(tilt)))

        return orbit if settings.route == "orbit" else transect

    def _standing(self, eye: Points, heading_deg: float, tilt_deg: float) -> Pose:
        """The pose at a place of a path, as `camera_altitude_m` and `camera_tilt_deg` say."""
        settings = self._settings
        if settings.camera_tilt_deg is not None:
            tilt_deg = settings.camera_tilt_deg
        ground_m = self._ground_m(eye) if settings.camera_altitude_m is not None else None
        if settings.camera_altitude_m is not None and ground_m is not None:
            eye = np.array([*eye[:2], ground_m + settings.camera_altitude_m])
        return pose(eye, heading_deg, tilt_deg, 0.0)

    def _clear(self, place: Points, level_m: float) -> Points:
        """The place at a level, or higher: clear of what lies under it."""
        ground_m = self._ground_m(place)
        clear = level_m if ground_m is None else max(level_m, ground_m + _CLEAR_M)
        return np.array([*place[:2], clear])

    def _ground_m(self, place: Points) -> float | None:
        """Height of the highest thing at a place."""
        top_m = float(self._world[0].mesh.vertices[:, 2].max()) + 1
        below = self._below(np.array([*place[:2], top_m]))
        return None if below is None else top_m - below

    def _below(self, eye: Points) -> float | None:
        """Metres to the first thing right under the eye."""
        optics, down = centred(500, _GROUND_PX, _GROUND_PX), pose(eye, 0, 90, 0)
        nearest = ZBuffer(down, optics, self._world[0]).inverse[(_GROUND_PX // 2,) * 2]
        return float(1 / nearest) if nearest > 0 else None


def _level(angle_rad: npt.ArrayLike) -> Points:
    """(..., 3) unit vectors along headings."""
    angle = np.asarray(angle_rad)
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)


@lru_cache(maxsize=4)
def trajectory(path: Path) -> tuple[Points, Points]:
    """Times (N,) in seconds and poses (N, 4, 4) from `time tx ty tz qx qy qz qw` lines."""
    names = ["time", "tx", "ty", "tz", "qx", "qy", "qz", "qw"]
    lines = numbered_lines(path)
    table = np.array([numbers_in(path, line, names) for line in lines]).reshape(-1, 8)
    length = np.linalg.norm(table[:, 4:], axis=1, keepdims=True)
    if not length.all():
        number, line = lines[int(np.argmin(length))]
        raise FactoryError(f"{path}:{number}: expected a rotation, got {line[:60]!r}")
    axis, w = np.split(table[:, 4:] / length, [3], axis=1)
    # R = (w^2 - a.a) I + 2 a a^T + 2 w [a]x  (Rodrigues' formula for the unit quaternion (a, w))
    outer = axis[:, :, None] * axis[:, None, :]
    cross = np.cross(axis[:, None, :], np.eye(3)[None], axisa=2, axisb=2)
    square = (w**2 - np.sum(axis**2, axis=1, keepdims=True))[:, :, None]
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, :3] = square * np.eye(3) + 2 * outer - 2 * w[:, :, None] * cross
    poses[:, :3, 3] = table[:, 1:4]
    return table[:, 0], poses
