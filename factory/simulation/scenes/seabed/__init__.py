"""Procedural seabed: FLSea-like RGBD frames of invented places, with labels and poses.

A location is a number: it fixes the ground, the objects, the water and the camera's path.  Frames
are drawn by one z-buffer, so depth, labels and images agree to the pixel.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from ....common.distribution import Altitude
from ....common.distribution import Angle as DrawnAngle
from ....common.errors import FactoryError
from ....common.limits import limited
from ....common.settings import STRICT
from ....dataset.frame_ref import FrameRef
from ....dataset.meaning import FITTING, ObjectName, class_names
from ...frames.frame import Frame, checked
from ...meshes.camera import Stance, movements
from ...meshes.camera import camera as optics_of
from ..base import Discovery, OwnClass, Root, SceneSettings
from ..moving import Mover, Moving, MovingObject, check_moving, check_paths
from .terrain import FITTED_PLACES, PLACE_NAMES, ObjectPlaceName, PlaceName

if TYPE_CHECKING:
    from ...meshes.triangle_mesh import Mesh
    from .world import SeabedWorld

GENERATOR = 4
"""Version of the frames: changes with their bytes, and is part of the names of cached renders."""
_LARGEST_M = 15.0  # of own objects; what is larger is in millimetres
_Share = Annotated[float, Field(ge=0, le=1)]
_Count = Annotated[int, Field(ge=0, le=200)]
_Tilt = Annotated[float, limited(-180, 180, "deg")]
_LAST = 10_000  # names have four digits and sort as numbers do
_HELD = 2  # a location takes a second to build and tens of megabytes


@dataclass(frozen=True, config=ConfigDict(**STRICT, serialize_by_alias=True), kw_only=True)
class OwnObject(OwnClass):
    """An entry of `scenes.own_objects`; see also `OwnClass`.

    file: .glb, .gltf, .obj, .ply, .stl, .blend, .fbx or .usd.
    up: the axis of the file that points up; auto: y of .glb and .gltf, z of others.
    per_place: least and most of them in a place.  scale: metres per unit of the file.
    burial: least and most of its height in the ground.  tilt_deg: likewise, from upright.
    colour: albedo (red, green, blue; 0 to 1) instead of the mesh's own colours and textures.
    moving: how it moves, see `Moving`; null: it lies on the ground.
    """

    file: Root
    per_place: tuple[_Count, _Count] = (0, 1)
    scale: Annotated[float, limited(1e-6, 1e6, "m")] = 1.0
    up: Literal["auto", "y", "z"] = "auto"
    burial: tuple[_Share, _Share] = (0.02, 0.18)
    tilt_deg: tuple[_Tilt, _Tilt] = (0.0, 10.0)
    colour: tuple[_Share, _Share, _Share] | None = None
    moving: Moving | None = None

    def __post_init__(self) -> None:
        for name in ("per_place", "burial", "tilt_deg"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: give the least first, then the most")

    def read(self, key: str) -> OwnMesh:
        """Read its file.  Raises FactoryError that names file and key."""
        from ...meshes.mesh_parts import files_of, read_model
        from ...meshes.triangle_mesh import join

        if self.label == "Background":
            raise FactoryError(f"{key}.class: Background is the ground; name it")
        path = Path(self.file).expanduser()
        up = "stated" if self.up == "auto" else self.up
        model = read_model(path, f"{key}.file", self.scale, _LARGEST_M, up)
        whole = join(part.mesh for part in model.parts)
        whole = whole.moved(-(whole.vertices.min(axis=0) + whole.vertices.max(axis=0)) / 2)
        if self.colour is not None:
            whole = whole.tinted(self.colour)
        return OwnMesh(whole, files_of(path, f"{key}.file"), model.notes)


class OwnMesh(NamedTuple):
    """The mesh of an own object, centred on the origin.

    files: that it was read from.  notes: lines for the user.
    """

    mesh: Mesh
    files: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class RecordingSettings(SceneSettings):
    """Keys of the readers whose scenes may be recordings; see `SeabedSettings`."""

    width: Annotated[int, Field(ge=64, le=4096)] = 968
    height: Annotated[int, Field(ge=48, le=4096)] = 608
    hfov_deg: Annotated[float, Field(gt=0, le=150)] | None = None
    vfov_deg: Annotated[float, Field(gt=0, le=60)] | None = None
    own_objects: tuple[OwnObject, ...] = ()
    frame_rate_hz: Annotated[float, Field(gt=0, le=1000)] | None = None
    moving_objects: tuple[MovingObject, ...] = ()
    boxes: bool = False
    camera_altitude_m: Altitude | None = None
    camera_tilt_deg: DrawnAngle | None = None

    def __post_init__(self) -> None:
        """Refuse half a sector, and objects that cannot move."""
        check_moving(self.moving)
        if self.moving and not self.is_recording:
            raise ValueError("moving objects need recordings; set frame_rate_hz, such as 10")
        if (self.hfov_deg is None) != (self.vfov_deg is None):
            raise ValueError("give hfov_deg and vfov_deg, or neither")

    @property
    def is_recording(self) -> bool:
        """Whether the frames of a scene are one recording."""
        return self.frame_rate_hz is not None

    @property
    def movers(self) -> dict[str, Mover]:
        """The entries whose objects move, by their configuration key."""
        by_key = {
            f"scenes.moving_objects.{number}": Mover(item.label, item.per_place, item.moving)
            for number, item in enumerate(self.moving_objects)
        }
        for number, own in enumerate(self.own_objects):
            if own.moving is not None:
                mover = Mover(own.label, own.per_place, own.moving)
                by_key[f"scenes.own_objects.{number}"] = mover
        return by_key

    @property
    def moving(self) -> dict[str, Moving]:
        """How each of the moving objects moves, by its configuration key."""
        return {key: mover.moving for key, mover in self.movers.items()}

    @property
    def has_moving_objects(self) -> bool:
        """See `SceneSettings`."""
        return bool(self.moving)

    @property
    def is_continuous(self) -> bool:
        """See `SceneSettings`."""
        return self.frame_rate_hz is not None or self.has_moving_objects


@dataclass(frozen=True, config=STRICT, kw_only=True)
class SeabedSettings(RecordingSettings):
    """Keys of `scenes` for the procedural seabed.

    locations: how many, from number `first_location` on; a number is a place of its own.
    frames_per_location: poses along its path.  width, height: pixels of a view 45 degrees wide.
    hfov_deg, vfov_deg: another sector for the camera to see; null: 45 degrees across, or the
    sonar's sector where that is wider.  A wider view has more pixels, as its solid angle grows.
    path: a CSV file of the movements of a platform (see `camera.moved`): its lines are then the
    frames of a location, from the pose of frame 0 on, and `frames_per_location` does not count.
    objects: factor on how many objects lie around.  kinds: only these (null: all).
    places: only these kinds of place, taken in turn (null: all but the flat places where objects
        are looked for: tank, harbour, flat_sand and mud).
    own_objects: the user's meshes; see `OwnObject`.
    frame_rate_hz: makes a recording of each location: its frames are pings from the first pose (or
        along `path`), so many a second.  Moving objects need it, or a path with times.
    moving_objects: objects that move through the recordings; see `moving.MovingObject`.
    boxes: of each frame's objects; `dataset.columns=[boxes]` sets it.
    camera_altitude_m, camera_tilt_deg: of every camera (of a path, its first pose) instead of what
    the places draw; `sonar.altitude_m` and `sonar.tilt_deg` set them.  Drawn for each frame; for
    each location in recordings.
    depth_gaps: whether depth is missing in places, as in depth maps that stereo matching made.
    """

    kind: Literal["seabed"] = "seabed"
    locations: Annotated[int, Field(ge=1, le=_LAST)] = 20
    first_location: Annotated[int, Field(ge=0, lt=_LAST)] = 0
    frames_per_location: Annotated[int, Field(ge=1, le=_LAST)] = 10
    path: Root | None = None
    objects: Annotated[float, Field(ge=0, le=4)] = 1.0
    kinds: tuple[ObjectName, ...] | None = None
    places: Annotated[tuple[PlaceName | ObjectPlaceName, ...], Field(min_length=1)] | None = None
    depth_gaps: bool = True

    def own(self) -> tuple[OwnClass, ...]:
        """See `SceneSettings`."""
        return (*self.own_objects, *self.moving_objects)

    def own_classes(self) -> tuple[str, ...]:
        """See `SceneSettings`; places with fittings have a class of theirs."""
        labels = super().own_classes()
        if FITTED_PLACES.intersection(self.places or ()):
            return (*labels, FITTING)
        return labels

    @property
    def is_recording(self) -> bool:
        """See `RecordingSettings`."""
        return super().is_recording or self.path is not None

    def rendered_ref(self, ref: FrameRef) -> FrameRef:
        """See `SceneSettings`: a sonar at rest sees the same static scene in all frames."""
        if self.frame_rate_hz is None or self.path is not None:
            return ref
        return replace(ref, frame="0000")

    def time_s(self, ref: FrameRef) -> float | None:
        """See `SceneSettings`."""
        number = int(ref.frame)
        if self.path is not None:
            line = movements(Path(self.path).expanduser())[number]
            if "time_s" in line:
                return line["time_s"]
        return None if self.frame_rate_hz is None else number / self.frame_rate_hz

    @property
    def start_s(self) -> float:
        """See `SceneSettings`: the time of the first line of a path."""
        if self.path is None:
            return 0.0
        return movements(Path(self.path).expanduser())[0].get("time_s", 0.0)

    def __post_init__(self) -> None:
        """Refuse locations whose number has more than four digits."""
        super().__post_init__()
        if self.first_location + self.locations > _LAST:
            raise ValueError(f"first_location + locations must not exceed {_LAST}")


class SeabedReader:
    """Makes frames of procedural locations.  A frame depends on settings and its name alone."""

    def __init__(self, settings: SeabedSettings) -> None:
        """Nothing is built before the first frame is loaded."""
        self._settings = settings
        self._world = lru_cache(maxsize=_HELD)(self._built)

    def discover(self) -> Discovery:
        """List the frames: scene `seabed-0007` is location number 7, frame `0003` its pose 3."""
        settings = self._settings
        lines = self._movements()
        first = settings.first_location
        frames = settings.frames_per_location if lines is None else len(lines)
        paths: tuple[str, ...] = () if settings.path is None else (settings.path,)
        # What is wrong with a mesh or a path shows before a worker starts.
        paths += tuple(path for _, own in self._own for path in own.files)
        refs = [
            FrameRef("seabed", f"seabed-{location:04d}", f"{frame:04d}", paths)
            for location in range(first, first + settings.locations)
            for frame in range(frames)
        ]
        self._check_moving(lines, refs[frames - 1])
        notes = (note for _, own in self._own for note in own.notes)
        return Discovery(tuple(refs), notes=tuple(notes))

    def _check_moving(self, lines: tuple[dict[str, float], ...] | None, last_ref: FrameRef) -> None:
        settings = self._settings
        if not settings.moving:
            return
        last_s = settings.time_s(last_ref)
        check_paths(settings.moving, None if last_s is None else last_s - settings.start_s)
        is_timed = settings.frame_rate_hz is not None
        is_timed = is_timed or all("time_s" in line for line in lines or ())
        if settings.moving and not is_timed:
            raise FactoryError(
                f"scenes.path={settings.path}: moving objects need the time of each line; give it "
                "a column time_s, or set scenes.frame_rate_hz"
            )

    def load(self, ref: FrameRef) -> Frame:
        """Build the location, if it is not at hand, and take the frame."""
        settings = self._settings
        number = int(ref.frame)
        if (lines := self._movements()) is not None:
            frame = self.load_moved(ref, lines[number], boxes=settings.boxes)
        else:
            frame = self._take(ref, None if settings.is_recording else number, settings.boxes)
        return replace(frame, time_s=settings.time_s(ref)) if settings.is_recording else frame

    def load_moved(
        self, ref: FrameRef, movement: dict[str, float], *, boxes: bool, has_colours: bool = True
    ) -> Frame:
        """Take the frame of a platform that has moved since the first frame; see `camera.moved`.

        has_colours: whether the image has the colours of the scene, or is black.
        """
        return self._take(ref, None, boxes, movement, has_colours=has_colours)

    def altitude_m(self, ref: FrameRef, movement: dict[str, float]) -> float:
        """Height above the ground of a platform that has moved since the first frame, metres."""
        from .view import altitude_m

        world = self._world(int(ref.scene.removeprefix("seabed-")))
        return altitude_m(world, self._stance(ref), movement)

    def _take(
        self,
        ref: FrameRef,
        number: int | None,
        boxes: bool,
        movement: dict[str, float] | None = None,
        *,
        has_colours: bool = True,
    ) -> Frame:
        """Take a frame of a location.

        number: of its place along the path; None: of a recording, which begins at place 0.
        """
        # Reading a configuration imports this module, but needs nothing that makes images.
        from .view import surroundings, take

        settings = self._settings
        optics = optics_of(settings.width, settings.height, settings.hfov_deg, settings.vfov_deg)
        world = self._world(int(ref.scene.removeprefix("seabed-")))
        stance = self._stance(ref)
        frame = take(
            world, number or 0, ref, optics, movement, boxes, stance,
            gaps=settings.depth_gaps, has_colours=has_colours,
        )  # fmt: skip
        if number is None:
            frame = replace(frame, surroundings=surroundings(world, stance))
        return checked(frame)

    def _stance(self, ref: FrameRef) -> Stance:
        """The stance of a frame, the same in all frames of a recording."""
        settings = self._settings
        frame = "" if settings.is_recording else ref.frame
        return Stance.drawn(
            settings.camera_altitude_m, settings.camera_tilt_deg, "seabed", ref.scene, frame
        )

    def _movements(self) -> tuple[dict[str, float], ...] | None:
        path = self._settings.path
        return None if path is None else movements(Path(path).expanduser())

    @cached_property
    def _own(self) -> list[tuple[OwnObject, OwnMesh]]:
        return [
            (own_object, own_object.read(f"scenes.own_objects.{number}"))
            for number, own_object in enumerate(self._settings.own_objects)
        ]

    def _built(self, location: int) -> SeabedWorld:
        from .world import Own, SeabedWorld

        settings = self._settings
        places = settings.places or PLACE_NAMES
        lying = [
            Own(item.label, item.per_place, item.tilt_deg, item.burial, own.mesh)
            for item, own in self._own
            if item.moving is None
        ]
        classes = class_names(settings.own_classes())
        return SeabedWorld(location, places, settings.objects, settings.kinds, lying, classes)
