"""A sonar at any pose of a scene: one ping at a time, with the bytes that `simnfnd make` gives."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Lock
from types import TracebackType
from typing import Any

import numpy as np

from ...common.errors import FactoryError, FrameError
from ...common.extras import require
from ..config.compose import compose_config
from ..config.needs import needs_of
from ..config.renderer_choice import renderer_of
from ..config.root import plain
from ..frames.frame import Frame
from ..imaging.settings import is_coherent
from ..moving.recordings import MovingRecordings
from ..pairs.compilation import compile_needed
from ..pairs.pair_maker import ObservedFrame, ObservedSample, observe_moment
from ..render import open_renderer
from ..render.view import view_of
from ..scenes import open_reader
from ..scenes.mesh import MeshReader, MeshSettings
from ..scenes.poses import optical_poses, pose_matrices
from ..scenes.seabed import SeabedReader
from .ping import Ping
from .pose import Pose, checked_index, checked_time_s

# A stream shows every ping on one scale and in one window.
_WORDS = (
    "experiment=physical", "render=analytic", "render.albedo=constant", "sonar.range.auto=false",
    "sonar.sector=whole", "sonar.transfer.full_scale_db=-55",
)  # fmt: skip
# A quarter of the default camera's pixels, for speed.
_CAMERA_WORDS = ("scenes.width=484", "scenes.height=304")
_RATE_HZ = 10.0


class Sonar:
    """A sonar in a scene, which pings at poses that the caller chooses.

        with Sonar("seabed", sonar="oculus_c550d_hf", seed=1) as sonar:
            ping = sonar.ping(Pose(surge_m=0.4, yaw_deg=3.0), index=7)

    A ping depends on the scene, the device, the seed, the pose, the index and the time alone, and
    not on the pings before it.  Several threads may ping at once with render=analytic or embree.

    words: the words of `simnfnd make` whose frames have the same bytes, but for `scenes.path` or
        `scenes.poses`, which holds the poses.
    """

    def __init__(
        self,
        scene: str = "seabed",
        *,
        sonar: str | None = None,
        seed: int | None = None,
        overrides: Sequence[str] = (),
    ) -> None:
        """scene, sonar: choices of `scenes` and `sonar`.  overrides: words of `simnfnd make`.

        Raises FactoryError for unknown names and keys, scenes whose poses are recorded, and drawn
        devices.
        """
        if scene not in ("seabed", "mesh"):
            raise FactoryError(
                f"scene={scene}: its poses are recorded; seabed and mesh take any pose"
            )
        self._folder = tempfile.TemporaryDirectory(prefix="simnfnd-sonar-")
        words = [*_WORDS, f"scenes={scene}", *_CAMERA_WORDS]
        if scene == "mesh":
            # The reader takes the axes of recorded poses; these are read from nowhere.
            path = Path(self._folder.name) / "poses.txt"
            path.write_text("0 0 0 0 0 0 0 1\n")
            words.append(f"scenes.poses={path}")
        else:
            words.append(f"scenes.frame_rate_hz={_RATE_HZ:g}")
        words += [f"sonar={sonar}"] if sonar is not None else []
        words += [f"seed={seed}"] if seed is not None else []
        self.words = (*words, *overrides)
        self._config = config = compose_config(self.words)
        if config.devices is not None:
            raise FactoryError("devices: a sonar is one device; leave devices out")
        require(needs_of(config))
        compile_needed(scenes=scene, field=is_coherent(config.acoustics))
        self._reader = open_reader(config.scenes)
        self._ref = self._reader.discover().frames[0]
        self._renderer = open_renderer(renderer_of(config).settings)
        self._recordings = MovingRecordings(config.scenes, config.seed)
        self._lock = Lock()
        self._is_closed = False

    @property
    def configuration(self) -> dict[str, Any]:
        """The whole configuration, as plain values."""
        return plain(self._config)

    def ping(
        self, pose: Pose | None = None, *, index: int = 0, time_s: float | None = None
    ) -> Ping:
        """The ping at a pose.

        index: the number of the frame of `make` whose random numbers it has.
        time_s: since the beginning of the scene, for objects that move; None: `index` pings at the
            scene's frame rate, 10 Hz if it has none.
        Raises FactoryError for a sonar that is closed and a pose that shows nothing of the scene.
        """
        pose = pose or Pose()
        number = checked_index(index)
        rate_hz = getattr(self._config.scenes, "frame_rate_hz", None) or _RATE_HZ
        at_s = checked_time_s(number / rate_hz if time_s is None else time_s)
        observed = self._observe(pose, number, at_s, has_boxes=False)
        return Ping(
            pose,
            number,
            at_s,
            ObservedSample(observed, 0, self._config),
            partial(self._observe, pose, number, at_s, has_boxes=True),
        )

    def close(self) -> None:
        """Release the scene; pings that were made stay, and what they were not asked for yet."""
        self._is_closed = True
        self._folder.cleanup()

    def __enter__(self) -> Sonar:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _observe(self, pose: Pose, index: int, time_s: float, *, has_boxes: bool) -> ObservedFrame:

        if self._is_closed:
            raise FactoryError("sonar: is closed; open another one")
        config = self._config
        mount = config.sonar.mount
        try:
            frame = self._load(pose, index, has_boxes)
            with self._lock:
                rendered = self._renderer.render(frame, mount)
            view = view_of(frame, rendered, mount)
            frame = view.frame(frame.ref)
            moment = self._recordings.moment_at(frame, view.rendered(), time_s)
            return observe_moment(moment, config)
        except FrameError as error:
            raise FactoryError(f"pose: {error}") from error

    def _load(self, pose: Pose, index: int, has_boxes: bool) -> Frame:
        """The frame of the scene's camera at a pose."""
        ref = replace(self._ref, frame=f"{index:04d}")
        settings = self._config.scenes
        if isinstance(self._reader, MeshReader) and isinstance(settings, MeshSettings):
            if pose.position_m is None or any(pose.movement.values()):
                raise FactoryError("pose: a mesh has no first pose; give position_m and quaternion")
            turn = np.array([pose.quaternion])
            turn /= np.linalg.norm(turn, axis=1, keepdims=True)
            stored = pose_matrices(np.array([pose.position_m], float), turn)
            matrix = optical_poses(stored, settings.poses_frame)[0]
            return self._reader.load_at(ref, matrix, boxes=has_boxes)
        assert isinstance(self._reader, SeabedReader)
        if pose.position_m is not None:
            raise FactoryError("pose: position_m is of meshes; give surge_m, sway_m and heave_m")
        altitude_m = self._reader.altitude_m(ref, pose.movement)
        if altitude_m <= 0:
            raise FactoryError(
                f"pose: heave_m={pose.heave_m:g} is {-altitude_m:.2f} m below the seabed"
            )
        has_colours = self._config.render.albedo != "constant"
        return self._reader.load_moved(ref, pose.movement, boxes=has_boxes, has_colours=has_colours)
