"""The `mesh` reader: a whole world of the user's, along recorded poses or a drawn path.

With `frame_rate_hz` (or poses) it gives recordings, through which objects may move.

What a pixel meets is what a ray through its centre meets first, found by the z-buffer of the
procedural scenes: exact, and a tenth of the time of tracing as many rays.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass as plain_dataclass
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from ...common.array_types import Float64s, UInt8s
from ...common.errors import FactoryError, FrameError
from ...common.files import shortened
from ...common.limits import limited
from ...common.seeds import stream
from ...common.settings import STRICT
from ...dataset.frame_ref import FrameRef
from ...dataset.meaning import class_names
from ..frames.frame import (
    GROUND_STEP_M,
    GROUND_STEPS,
    Frame,
    Intrinsics,
    Surroundings,
    checked,
)
from ..meshes.blend_files import camera_image
from ..meshes.camera import Objects, Optics, Pose, Stance, ZBuffer, camera, centred, pose
from ..meshes.mesh_parts import READING, MeshPart, Up, files_of, read_model, stands_like_a_wall
from ..meshes.painted import read_image
from .base import LONGEST_NAME, Discovery, OwnClass, Root
from .moving import check_paths
from .poses import PosesFrame, axes_remark, optical_trajectory, trajectory
from .seabed import RecordingSettings

_LARGEST_M = 3000.0
_KEY = "scenes.file"
_CLEAR_M = 0.3
_HIGH_M = 5000.0  # height from which rays are practically parallel
_Metres = Annotated[float, limited(-5000, 5000, "m")]
_Tilt = Annotated[float, limited(-90, 90, "deg")]
Span = tuple[_Metres, _Metres]
TiltSpan = tuple[_Tilt, _Tilt]


PosesAlong = Callable[[float, Stance], Pose]
"""The pose after this many metres along a drawn path, by a stance."""


@dataclass(frozen=True, config=ConfigDict(**STRICT, serialize_by_alias=True), kw_only=True)
class PartClass(OwnClass):
    """An entry of `scenes.classes`.  parts: name of its parts in the file, or a pattern."""

    parts: str


@dataclass(frozen=True, config=STRICT, kw_only=True)
class MeshSettings(RecordingSettings):
    """Keys of `scenes=mesh`.

    file: .glb, .gltf, .obj, .ply, .stl, .fbx, .usd, or .blend (whose images Cycles makes with its
        own materials).  scale: metres per unit of the file.
    up: the axis of the file that points up; auto: y of .glb and .gltf, z of others, but y of a
        world whose ground lies along x and z (not where poses are given).
    classes: see `PartClass`; other parts are Background.
    poses: a file of `time tx ty tz qx qy qz qw` lines (TUM), or of columns that its header names:
        camera to world in metres; null: drawn paths.
    poses_frame: axes of the poses; see `poses.PosesFrame`.
    route: orbit (around a named part, or all) or transect (straight over the world).
    paths, views_per_path: how many paths, each a scene, and views of each, a second apart.
    frame_rate_hz: makes a recording of each drawn path: its views are pings, this many per second.
    moving_objects, own_objects: objects that move in the recordings; see `moving.MovingObject` and
        `seabed.OwnObject`, of which each needs `moving`.  They need frame_rate_hz, or poses.
    height_m: least and most above the ground right under the camera.  distance_m: of an orbit.
    tilt_deg: how far a transect looks down.  speed_m_s: of the camera; 0 in a recording: at rest.
    width, height, hfov_deg, vfov_deg: of the camera; these, boxes, camera_altitude_m and
        camera_tilt_deg as of `scenes=seabed`; the latter are of drawn paths.
    """

    kind: Literal["mesh"] = "mesh"
    file: Root
    scale: Annotated[float, limited(1e-6, 1e6, "m")] = 1.0
    up: Up = "auto"
    classes: tuple[PartClass, ...] = ()
    poses: Root | None = None
    poses_frame: PosesFrame = "optical"
    route: Literal["orbit", "transect"] = "orbit"
    paths: Annotated[int, Field(ge=1, le=9999)] = 4
    views_per_path: Annotated[int, Field(ge=1, le=9999)] = 25
    height_m: Span = (1.0, 2.0)
    distance_m: Span = (2.0, 4.0)
    tilt_deg: TiltSpan = (20.0, 35.0)
    speed_m_s: Annotated[float, limited(0, 30, "m/s")] = 0.5

    def __post_init__(self) -> None:
        """Refuse views that are all alike, and objects that cannot move."""
        super().__post_init__()
        if self.speed_m_s == 0 and self.frame_rate_hz is None:
            raise ValueError("speed_m_s: 0 is of recordings; set frame_rate_hz, such as 10")
        if self.poses is not None and self.frame_rate_hz is not None:
            raise ValueError("frame_rate_hz: recorded poses have times of their own; leave it out")
        if self.poses is None and self.poses_frame != "optical":
            raise ValueError("poses_frame: is of recorded poses; set poses, or leave it out")
        if not all(own_object.moving for own_object in self.own_objects):
            raise ValueError("own_objects need moving; put what lies still into scenes.file")

    def own(self) -> tuple[OwnClass, ...]:
        """See `SceneSettings`."""
        return (*self.classes, *self.own_objects, *self.moving_objects)

    @property
    def is_recording(self) -> bool:
        """See `RecordingSettings`."""
        return super().is_recording or self.poses is not None

    def rendered_ref(self, ref: FrameRef) -> FrameRef:
        """See `SceneSettings`: a sonar at rest sees the same static scene in all frames."""
        return replace(ref, frame="0000") if self.speed_m_s == 0 else ref

    def time_s(self, ref: FrameRef) -> float:
        """See `SceneSettings`."""
        view = int(ref.frame)
        if self.poses is not None:
            return float(self._pose_times_s()[view])
        return view / (self.frame_rate_hz or 1.0)

    @property
    def start_s(self) -> float:
        """See `SceneSettings`."""
        return 0.0 if self.poses is None else float(self._pose_times_s()[0])

    def _pose_times_s(self) -> Float64s:
        assert self.poses is not None
        return trajectory(Path(self.poses).expanduser())[0]


@plain_dataclass(frozen=True, eq=False)
class MeshWorld:
    """A mesh file ready to be seen.

    shades: (T + 1, 3) uint8 of its faces and of nothing.  origin_m: (3,) of its coordinates in
    those of the file, metres, z up.  notes: lines for the user.
    """

    objects: Objects
    shades: UInt8s
    origin_m: Float64s
    notes: tuple[str, ...]


class MeshReader:
    """Takes frames of one world, as the name of a frame and the settings decide."""

    def __init__(self, settings: MeshSettings) -> None:
        """Nothing is read before it is needed."""
        self._settings = settings
        self._path = Path(settings.file).expanduser()
        self._poses_along = cache(self._draw_path)
        self._cached_surroundings = cache(self._surroundings)

    def discover(self) -> Discovery:
        """List the frames: scene `orbit-0003` is the path number 3, frame `0007` its view 7."""
        settings = self._settings
        paths = files_of(self._path, _KEY)
        views = settings.views_per_path
        scenes = [f"{settings.route}-{path:04d}" for path in range(settings.paths)]
        notes = self._world.notes  # read, so that bad files show here
        if settings.poses is not None:
            recorded = Path(settings.poses).expanduser()
            scenes = ["poses"]
            views = len(trajectory(recorded)[0])
            paths += (str(recorded),)
        for number, own_object in enumerate(settings.own_objects):
            own_mesh = own_object.read(f"scenes.own_objects.{number}")
            paths += own_mesh.files
            notes += own_mesh.notes
        # What is wrong with a path shows before a worker starts.
        location = shortened(self._path.stem, LONGEST_NAME)
        last_ref = FrameRef(location, scenes[0], f"{views - 1:04d}")
        duration_s = settings.time_s(last_ref) - settings.start_s
        paths += check_paths(settings.moving, duration_s)
        views_of_scenes = itertools.product(scenes, range(views))
        refs = (FrameRef(location, scene, f"{view:04d}", paths) for scene, view in views_of_scenes)
        return Discovery(tuple(refs), notes=notes)

    def load(self, ref: FrameRef) -> Frame:
        """See `Reader`."""
        settings = self._settings
        frame = self._take(ref, self._viewpoint(ref.scene, ref.frame), settings.boxes)
        return replace(frame, time_s=settings.time_s(ref))

    def load_at(self, ref: FrameRef, world_from_camera: Float64s, *, boxes: bool) -> Frame:
        """Take the frame of a camera at a (4, 4) pose in the axes of recorded poses, z up."""
        return self._take(ref, self._pose_at(world_from_camera), boxes)

    def _pose_at(self, world_from_camera: Float64s) -> Pose:
        eye = world_from_camera[:3, 3] - self._world.origin_m
        return Pose(eye, np.ascontiguousarray(world_from_camera[:3, :3]))

    def _take(self, ref: FrameRef, viewpoint: Pose, boxes: bool) -> Frame:
        settings = self._settings
        world = self._world
        optics = camera(settings.width, settings.height, settings.hfov_deg, settings.vfov_deg)
        z_buffer = ZBuffer(viewpoint, optics, world.objects)
        segmentation, instance = z_buffer.shown
        frame = Frame(
            ref=ref,
            rgb=self._camera_image(viewpoint, optics, world.shades[z_buffer.which]),
            depth_m=np.where(z_buffer.which < 0, np.float32(0), z_buffer.depth_m),
            intrinsics=Intrinsics(*optics.lens),
            world_from_camera=viewpoint.matrix,
            segmentation=segmentation,
            instance=instance,
            altitude_m=self._altitude_m(viewpoint.eye),
            boxes=z_buffer.boxes(instance) if boxes else None,
            surroundings=self._cached_surroundings(ref.scene) if settings.is_recording else None,
        )
        try:
            return checked(frame)
        except FrameError as error:
            if settings.poses is None:
                raise
            remark = axes_remark(settings.poses_frame, viewpoint.matrix[:3, 2])
            raise FrameError(f"{error}; {remark}") from error

    def _viewpoint(self, scene: str, frame: str) -> Pose:
        settings = self._settings
        view = int(frame)
        if settings.poses is not None:
            recorded = Path(settings.poses).expanduser()
            return self._pose_at(optical_trajectory(recorded, settings.poses_frame)[1][view])
        time_s = view / (settings.frame_rate_hz or 1.0)
        stance = Stance.drawn(
            settings.camera_altitude_m,
            settings.camera_tilt_deg,
            *("mesh", scene, "" if settings.is_recording else frame),
        )
        return self._poses_along(int(scene[-4:]))(settings.speed_m_s * time_s, stance)

    def _surroundings(self, scene: str) -> Surroundings:
        """Where a recording begins, and the height of the highest things around.

        Where there is nothing, the world's lowest point is the ground.
        """
        start = self._viewpoint(scene, "0000")
        objects = self._world.objects
        heights_m = objects.mesh.vertices[:, 2]
        # From so far above that all rays run down: a pixel is a step of the ground.
        eye = np.array([*start.eye[:2], float(heights_m.max()) + _HIGH_M])
        size = 2 * GROUND_STEPS + 1
        down = pose(eye, 0, 90, 0)
        inverse = ZBuffer(down, centred(_HIGH_M / GROUND_STEP_M, size, size), objects).inverse
        with np.errstate(divide="ignore"):
            ground_m = np.where(inverse > 0, eye[2] - 1 / inverse, heights_m.min())
        # Rows of the image go against the world's x, columns against its y.
        along = np.ascontiguousarray(ground_m[::-1, ::-1].T, np.float32)
        return Surroundings(start.matrix, along, GROUND_STEP_M)

    @cached_property
    def _world(self) -> MeshWorld:
        settings = self._settings
        up = "stated" if settings.up == "auto" and settings.poses is not None else settings.up
        model = read_model(self._path, _KEY, settings.scale, _LARGEST_M, up)
        notes = model.notes
        if up == "stated" and stands_like_a_wall(model.parts):
            notes += (
                f"{self._path.name}: stands upright like a wall; where y points up in it and in "
                "the poses is z, set scenes.up=y",
            )
        objects = Objects([part.mesh for part in model.parts], self._labels(model.parts))
        return MeshWorld(objects, _shades(objects), model.origin_m, notes)

    def _labels(self, parts: tuple[MeshPart, ...]) -> UInt8s:
        """(N,) classes of the parts.  Raises FactoryError for a pattern that no name matches."""
        settings = self._settings
        class_numbers = class_names(settings.own_classes())
        labels = np.zeros(len(parts), np.uint8)
        for stated in settings.classes:
            matching = [
                number
                for number, part in enumerate(parts)
                if part.name == stated.parts or fnmatchcase(part.name, stated.parts)
            ]
            if not matching:
                known = ", ".join(sorted({part.name for part in parts}))[:200]
                raise FactoryError(
                    f"scenes.classes: no part is called {stated.parts}; there are {known}"
                )
            labels[matching] = class_numbers.index(stated.label)
        return labels

    def _camera_image(self, viewpoint: Pose, optics: Optics, shaded: UInt8s) -> UInt8s:
        """What a camera sees of a .blend, in its own materials; of other files the shaded faces."""
        if self._path.suffix.lower() != ".blend":
            return shaded
        matrix = viewpoint.matrix
        matrix[:3, 3] = (matrix[:3, 3] + self._world.origin_m) / self._settings.scale
        arguments = matrix.tolist(), list(optics.lens), optics.width, optics.height
        content = READING.call(camera_image, self._path, *arguments, limit_s=600.0)
        return read_image(content)

    def _draw_path(self, path: int) -> PosesAlong:
        """Draw a path, and measure the ground under it; metres travelled give the pose."""
        settings = self._settings
        rng = stream(0, "mesh", settings.route, path)
        target = self._draw_target(rng)
        height_m = rng.uniform(*settings.height_m)
        heading_rad = rng.uniform(0, 2 * np.pi)
        if settings.route == "orbit":
            return self._orbit(target, rng, height_m, heading_rad)
        return self._transect(target, rng, height_m, heading_rad)

    def _draw_target(self, rng: np.random.Generator) -> PathTarget:
        """Choose one of the parts with a class, or the whole world where none has a class."""
        objects = self._world.objects
        classified = np.flatnonzero(objects.labels)
        points = objects.mesh.vertices
        if len(classified):
            first, _, last, _ = objects.parts[rng.choice(classified)]
            points = points[first:last]
        low = points.min(axis=0).astype(float)
        high = points.max(axis=0).astype(float)
        reach_m = float(np.hypot(*(high - low)[:2])) / 2
        return PathTarget((low + high) / 2, reach_m, is_part=len(classified) > 0)

    def _orbit(
        self, target: PathTarget, rng: np.random.Generator, height_m: float, heading_rad: float
    ) -> PosesAlong:
        """A circle around the target, which stays in the middle of the image."""
        distance_m = rng.uniform(*self._settings.distance_m)
        side = rng.choice([-1, 1])
        distance_m += target.reach_m * target.is_part
        around = target.centre + distance_m * _level(np.linspace(0, 2 * np.pi, 9)[1:])
        ground_m = self._level_above(around, target)
        level_m = ground_m + height_m

        def orbit(travelled_m: float, stance: Stance) -> Pose:
            angle = heading_rad + travelled_m / (side * distance_m)
            eye = self._clear(target.centre + distance_m * _level(angle), level_m)
            down_deg = np.rad2deg(np.arctan2(eye[2] - target.centre[2], distance_m))
            heading_deg = float(np.rad2deg(angle + np.pi))
            return self._standing(eye, heading_deg, float(down_deg), ground_m, stance)

        return orbit

    def _transect(
        self, target: PathTarget, rng: np.random.Generator, height_m: float, heading_rad: float
    ) -> PosesAlong:
        """A straight line over the target, looking ahead and down."""
        aside_m = 2 * rng.uniform(-0.25, 0.25) * target.reach_m
        ahead = _level(heading_rad)
        aside = aside_m * _level(heading_rad + np.pi / 2)
        along = target.centre + np.linspace(-1, 1, 9)[:, None] * ahead * target.reach_m + aside
        tilt_rad = np.deg2rad(rng.uniform(*self._settings.tilt_deg))
        ground_m = self._level_above(along, target)
        level_m = ground_m + height_m
        heading_deg = float(np.rad2deg(heading_rad))
        tilt_deg = float(np.rad2deg(tilt_rad))

        def transect(travelled_m: float, stance: Stance) -> Pose:
            point = target.centre + (travelled_m - target.reach_m) * ahead + aside
            eye = self._clear(point, level_m)
            return self._standing(eye, heading_deg, tilt_deg, ground_m, stance)

        return transect

    def _level_above(self, points: Float64s, target: PathTarget) -> float:
        """Height of the ground below a path: the median at (N, 3) points along it."""
        measured = [height for height in map(self._ground_m, points) if height is not None]
        return float(np.median(measured)) if measured else float(target.centre[2])

    def _standing(
        self,
        eye: Float64s,
        heading_deg: float,
        tilt_deg: float,
        path_ground_m: float,
        stance: Stance,
    ) -> Pose:
        """The pose at a point of a path, as its stance says.

        path_ground_m: height of the ground along the path, which counts where none lies below.
        """
        if stance.tilt_deg is not None:
            tilt_deg = stance.tilt_deg
        if stance.altitude_m is not None:
            ground_m = self._ground_m(eye)
            if ground_m is None:
                ground_m = path_ground_m
            eye = np.array([*eye[:2], ground_m + stance.altitude_m])
        return pose(eye, heading_deg, tilt_deg, 0.0)

    def _clear(self, point: Float64s, level_m: float) -> Float64s:
        """The point at a level, or higher: clear of what lies under it."""
        ground_m = self._ground_m(point)
        clear = level_m if ground_m is None else max(level_m, ground_m + _CLEAR_M)
        return np.array([*point[:2], clear])

    def _ground_m(self, point: Float64s) -> float | None:
        """Height of the highest surface at a point, metres; None where there is none."""
        top_m = float(self._world.objects.mesh.vertices[:, 2].max()) + 1
        below = self._altitude_m(np.array([*point[:2], top_m]))
        return None if below is None else top_m - below

    def _altitude_m(self, eye: Float64s) -> float | None:
        """Metres from the eye down to the first surface; None where there is none."""
        down = pose(eye, 0, 90, 0)
        nearest = ZBuffer(down, centred(500, 1, 1), self._world.objects).inverse[0, 0]
        return float(1 / nearest) if nearest > 0 else None


@plain_dataclass(frozen=True, eq=False)
class PathTarget:
    """What a path goes round or over: its middle (3,), half its diagonal seen from above, metres.

    is_part: it is a part with a class, and not the whole world.
    """

    centre: Float64s
    reach_m: float
    is_part: bool


def _shades(objects: Objects) -> UInt8s:
    """(T + 1, 3) sRGB of the faces lit from above, as through water; the last is black."""
    a, b, c = objects.mesh.vertices[objects.mesh.triangles].transpose(1, 0, 2)
    normal = np.cross(b - a, c - a)
    up = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-20)
    light = (0.65 + 0.35 * up)[:, None]
    albedo = objects.mesh.colours[objects.mesh.triangles].mean(axis=1)
    shades = np.round(255 * np.clip(albedo * light, 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return np.append(shades, np.zeros((1, 3), np.uint8), axis=0)


def _level(angle_rad: npt.ArrayLike) -> Float64s:
    """(..., 3) unit vectors along headings."""
    angle = np.asarray(angle_rad)
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
