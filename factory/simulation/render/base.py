"""What all renderers share: where the sonar is, their settings, what they return and need.

Camera axes (OpenCV): x right, y down, z forward.  Sonar axes: x forward, y left, z up (REP 103).
"""

from __future__ import annotations

import os
from dataclasses import dataclass as plain_dataclass
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal, Protocol

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from ...common.array_types import Bools, Float32s, Float64s, Int32s
from ...common.limits import limited
from ...common.settings import STRICT
from ..frames.frame import Frame

_Offset = Annotated[float, limited(-100, 100, "m")]

# Rows are the sonar's axes in camera axes, for a sonar that looks where the camera looks.
_SONAR_FROM_CAMERA_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, config=STRICT)
class Mount:
    """Pose of the sonar at the camera.

    translation_m: position of the sonar as seen from the camera, (forward, left, up) in metres.
    pitch_deg: positive looks further down.  yaw_deg: positive looks further left.
    """

    translation_m: tuple[_Offset, _Offset, _Offset] = (0.0, 0.0, 0.0)
    pitch_deg: Annotated[float, limited(-180, 180, "deg")] = 0.0
    yaw_deg: Annotated[float, limited(-180, 180, "deg")] = 0.0

    @property
    def colocated(self) -> bool:
        """True when the sonar is at the camera: what the camera sees, the sonar insonifies."""
        return not any(self.translation_m)

    def camera_tilt_deg(self, sonar_tilt_deg: float) -> float | None:
        """Tilt of a level camera whose sonar looks so far down; None where no tilt gives that.

        The sonar looks along (cos yaw cos pitch, sin yaw cos pitch, -sin pitch) in the camera's
        forward, left, up; below the horizon by sin T = sin pitch cos t + cos yaw cos pitch sin t of
        a camera tilted by t.
        """
        pitch, yaw = np.deg2rad([self.pitch_deg, self.yaw_deg])
        ahead = np.cos(yaw) * np.cos(pitch)
        down = np.sin(pitch)
        sine = np.sin(np.deg2rad(sonar_tilt_deg)) / np.hypot(ahead, down)
        if abs(sine) > 1:
            return None
        # So that 15 degrees stay 15.
        return round(float(np.rad2deg(np.arcsin(sine) - np.arctan2(down, ahead))), 9)

    def height_above_camera_m(self, camera_tilt_deg: float) -> float:
        """How much higher than a level camera that is tilted so far the sonar is."""
        forward_m, _, up_m = self.translation_m
        tilt = np.deg2rad(camera_tilt_deg)
        return float(up_m * np.cos(tilt) - forward_m * np.sin(tilt))

    def rotation_sonar_from_camera(self) -> Float64s:
        """(3, 3): turns directions in camera axes into sonar axes."""
        pitch, yaw = np.deg2rad([self.pitch_deg, self.yaw_deg])
        about_left = np.array(
            [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
        )
        about_up = np.array(
            [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
        )
        return np.asarray((about_up @ about_left).T @ _SONAR_FROM_CAMERA_AXES)

    def position_camera_m(self) -> Float64s:
        """(3,) position of the sonar in camera axes, metres."""
        return np.asarray(_SONAR_FROM_CAMERA_AXES.T @ np.asarray(self.translation_m))

    def in_sonar_axes(self, camera_m: Float64s) -> Float64s:
        """(N, 3) places in sonar axes, metres, for (N, 3) places in camera axes."""
        x, y, z = (camera_m - self.position_camera_m()).T
        # Spelled out, for a matrix product of many points may round differently on other
        # processors.
        rows = self.rotation_sonar_from_camera()
        return np.stack([row[0] * x + row[1] * y + row[2] * z for row in rows], axis=-1)

    def axes(self) -> tuple[Float32s, Float32s]:
        """Both of them in single precision, as compiled loops want them."""
        turn = self.rotation_sonar_from_camera()
        position_m = self.position_camera_m()
        return np.ascontiguousarray(turn, np.float32), position_m.astype(np.float32)


@dataclass(frozen=True, config=STRICT)
class RenderSettings:
    """Keys of the `render` group.

    kind: cycles (Blender), embree (Open3D ray casting), analytic (closed form in numpy, no
        shadows) or auto: cycles where the sonar is away from the camera or the scene is a .blend
        file, else analytic.
    albedo: rgb (luminance of the colour image), flattened (luminance over its local mean, which
        takes out the water's haze and colour), or constant.
    edge_ratio: neighbouring pixels whose depths differ by more than this fraction are different
        surfaces and are never joined.
    bounces: 1 traces the paths by way of a second surface, for ghosts; needs Embree.
    reflection_loss_db: intensity lost where a surface mirrors sound, dB; smooth steel or concrete
        1, rock 3, sand 8, mud 15.
    """

    kind: Literal["auto", "cycles", "embree", "analytic"] = "auto"
    albedo: Literal["rgb", "flattened", "constant"] = "flattened"
    edge_ratio: Annotated[float, Field(gt=0, le=1)] = 0.1
    bounces: Annotated[int, Field(ge=0, le=1)] = 0
    reflection_loss_db: Annotated[float, Field(ge=0, le=100)] = 8.0


@dataclass(frozen=True, config=STRICT)
class CacheSettings:
    """Keys of the `cache` group.

    enabled: keep renders for later runs; else they last until the run ends.
    dir: folder of the cache.  max_bytes: when it holds more, what was not used for longest goes.
    """

    enabled: bool = True
    dir: Annotated[str, Field(min_length=1)] = "outputs/cache"
    max_bytes: Annotated[int, Field(ge=1)] = 20_000_000_000

    @property
    def folder(self) -> Path:
        """`dir` as an absolute path: workers may have another working folder."""
        return Path(os.path.abspath(Path(self.dir).expanduser()))


@plain_dataclass(frozen=True, eq=False)
class Bounces:
    """N paths from the sonar by way of a mirroring surface to a second one.

    mirror, second: (N,) int32 flat camera pixels of both surfaces; the sonar insonifies both.
    distance_m: (N,) float32 from the one to the other.
    reflection_loss_db: intensity lost at the mirror, dB.
    pixels_each: camera pixels for which a path stands.
    """

    mirror: Int32s
    second: Int32s
    distance_m: Float32s
    reflection_loss_db: float
    pixels_each: int

    def clear_of(self, covered: Bools) -> Bounces:
        """The paths that touch no covered pixel; covered: (pixels,)."""
        is_clear = ~(covered[self.mirror] | covered[self.second])
        return replace(
            self,
            mirror=self.mirror[is_clear],
            second=self.second[is_clear],
            distance_m=self.distance_m[is_clear],
        )


@plain_dataclass(frozen=True, eq=False)
class Rendered:
    """The render of one frame, pixel by pixel of the camera.

    radiance: (H, W) float32, albedo * cos(incidence) / range^2 with the light at the sonar, range
        in metres; 0 where nothing is or where the sonar's sound does not reach (shadow).
    surface: (H, W) bool, pixels whose ray meets the scene, lit or in shadow.
    bounces: paths by way of a second surface; None where none were traced or found.
    """

    radiance: Float32s
    surface: Bools
    bounces: Bounces | None = None


class Renderer(Protocol):
    """Renders frames one after another in one process; holds its scene between frames."""

    def render(self, frame: Frame, mount: Mount) -> Rendered:
        """Render one frame with the light at the sonar.  Same input, same bytes."""
