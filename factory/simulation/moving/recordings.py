"""The moments of recordings: a rendered frame, and the objects that move in it at its time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from ...common.errors import FrameError
from ..frames.frame import Frame
from ..render.base import Rendered
from ..scenes import SceneSettings
from ..scenes.seabed import RecordingSettings
from .cast import Actor, draw_cast
from .compose import PosedBody, bodies_at

SceneType = TypeVar("SceneType")


@dataclass(frozen=True, eq=False)
class Moment:
    """A frame of a scene, rendered without its moving objects.

    bodies: those that are there.  is_continuous: whether the frames of its scene are pings of one
    device, one after another.  static: what knows the static scene of an earlier frame.
    cast: all moving objects of the recording.  course_s: the time on their courses.
    """

    frame: Frame
    rendered: Rendered
    bodies: Sequence[PosedBody] = ()
    is_continuous: bool = False
    static: StaticScene | None = None
    cast: Sequence[Actor] = ()
    course_s: float = 0.0

    def later(self, delay_s: float) -> Moment:
        """The moment later within one ping: objects have moved on, the sonar has not."""
        course_s = self.course_s + delay_s
        return replace(self, bodies=bodies_at(self.cast, self.frame, course_s), course_s=course_s)


class StaticScene:
    """Holds the static scene that the frames of a sonar at rest share, with all that it knows.

    name: of the render that it was made of.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._held: tuple[object, Any] = (None, None)

    def held_scene(self, scene: SceneType, made_by: object) -> SceneType:
        """The scene held so far, if equal settings made it; else `scene`, held from then on.

        made_by: the settings that made `scene`.
        """
        if self._held[0] != made_by:
            self._held = made_by, scene
        held: SceneType = self._held[1]
        return held


class MovingRecordings:
    """Gives the moments of a configuration's recordings; holds the cast of the last one."""

    def __init__(self, settings: SceneSettings, seed: int) -> None:
        """Draws nothing before the first moment."""
        self._settings = settings
        self._seed = seed
        self._static = StaticScene("")
        self._cast: tuple[tuple[str, str], tuple[Actor, ...]] = (("", ""), ())

    def moment(self, frame: Frame, rendered: Rendered) -> Moment:
        """The moment of a rendered frame of the recording.  Raises FrameError; see `moment_at`."""
        settings = self._settings
        if not settings.is_continuous:
            return Moment(frame, rendered)
        moment = self.moment_at(frame, rendered, settings.time_s(frame.ref))
        if not moment.cast:
            return moment
        name = settings.rendered_ref(frame.ref).name
        if self._static.name != name:
            self._static = StaticScene(name)
        return replace(moment, static=self._static)

    def moment_at(self, frame: Frame, rendered: Rendered, time_s: float | None) -> Moment:
        """The moment of a frame that was rendered at any pose.

        Raises FrameError for a frame without a time or a pose where objects move.
        """
        settings = self._settings
        frame = replace(frame, time_s=time_s)
        if not isinstance(settings, RecordingSettings) or not settings.has_moving_objects:
            return Moment(frame, rendered, is_continuous=settings.is_continuous)
        if time_s is None or frame.surroundings is None or frame.world_from_camera is None:
            raise FrameError(f"{frame.ref.name}: moving objects need its time and its pose")
        cast = self._cast_of(frame, settings)
        course_s = time_s - settings.start_s
        bodies = bodies_at(cast, frame, course_s)
        return Moment(frame, rendered, bodies, is_continuous=True, cast=cast, course_s=course_s)

    def _cast_of(self, frame: Frame, settings: RecordingSettings) -> tuple[Actor, ...]:
        name = frame.ref.location, frame.ref.scene
        if self._cast[0] != name:
            assert frame.surroundings is not None
            cast = draw_cast(settings, self._seed, frame.ref, frame.surroundings)
            self._cast = name, cast
        return self._cast[1]
