"""Where the sonar sits relative to the RGBD camera.

Camera axes (OpenCV): x right, y down, z forward.  Sonar axes: x forward, y left, z up (REP 103).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from pydantic.dataclasses import dataclass

from ..settings import STRICT

# Rows are the sonar's axes in camera axes, for a sonar that looks where the camera looks.
_SONAR_FROM_CAMERA_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True, config=STRICT)
class Mount:
    """Pose of the sonar at the camera.

    translation_m: position of the sonar as seen from the camera, (forward, left, up) in metres.
    pitch_deg: positive looks further down.  yaw_deg: positive looks further left.
    """

    translation_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0

    @property
    def colocated(self) -> bool:
        """True when the sonar is at the camera: what the camera sees, the sonar insonifies."""
        return not any(self.translation_m)

    def rotation_sonar_from_camera(self) -> npt.NDArray[np.float64]:
        """(3, 3): turns directions in camera axes into sonar axes."""
        pitch, yaw = np.deg2rad([self.pitch_deg, self.yaw_deg])
        about_left = np.array(
            [[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]]
        )
        about_up = np.array(
            [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
        )
        return np.asarray((about_up @ about_left).T @ _SONAR_FROM_CAMERA_AXES)

    def position_camera_m(self) -> npt.NDArray[np.float64]:
        """(3,) position of the sonar in camera axes, metres."""
        return np.asarray(_SONAR_FROM_CAMERA_AXES.T @ np.asarray(self.translation_m))

    def axes(self) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Both of them in single precision, as compiled loops want them."""
        turn, position_m = self.rotation_sonar_from_camera(), self.position_camera_m()
        return np.ascontiguousarray(turn, np.float32), position_m.astype(np.float32)
