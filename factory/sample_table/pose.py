"""Where camera and sonar were: columns of `/meta` that `dataset.columns=[pose]` asks for.

World axes are the recording's; of `scenes=seabed` z is up.  Camera axes: x right, y down, z
forward; sonar axes: x forward, y left, z up (REP 103).  A quaternion (x, y, z, w) turns directions
in the axes of the device into those of the world.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from ..dataset.schema import Column
from ..frame import Frame
from ..render.base import Mount

Matrix = npt.NDArray[np.float64]

_PARTS = (
    *((f"{axis}_m", "m", f"position along the world's {axis}") for axis in "xyz"),
    *((f"q{part}", "1", f"quaternion to world axes, {part}") for part in "xyzw"),
)
_OTHERS = (
    Column("time_s", "f8", "s", "when the frame was taken, from any beginning"),
    Column("sonar.tilt_deg", "f8", "deg", "how far the sonar looks below the horizon"),
    Column("sonar.heading_deg", "f8", "deg", "where it looks, from the world's x towards its y"),
    Column("sonar.roll_deg", "f8", "deg", "how far its left side is up"),
    Column("sonar.altitude_m", "f8", "m", "height above the ground right under the camera"),
)

COLUMNS = (
    *(
        Column(f"{device}.{name}", "f8", unit, f"of the {device}: {what}")
        for device in ("camera", "sonar")
        for name, unit, what in _PARTS
    ),
    *_OTHERS,
)
"""NaN where the recording does not say."""


def row(frame: Frame, mount: Mount) -> dict[str, float]:
    """The values of `COLUMNS` for a frame and the sonar mounted at its camera."""
    values = dict.fromkeys((column.name for column in COLUMNS), float("nan"))
    if frame.time_s is not None:
        values["time_s"] = frame.time_s
    if frame.world_from_camera is None:
        return values
    camera = np.asarray(frame.world_from_camera, np.float64)
    sonar = world_from_sonar(camera, mount)
    for device, pose in (("camera", camera), ("sonar", sonar)):
        numbers = (*pose[:3, 3].tolist(), *_quaternion(pose[:3, :3]).tolist())
        for (name, _, _), number in zip(_PARTS, numbers, strict=True):
            values[f"{device}.{name}"] = number
    forward, left = sonar[:3, 0], sonar[:3, 1]
    values["sonar.tilt_deg"] = float(np.rad2deg(np.arcsin(np.clip(-forward[2], -1, 1))))
    values["sonar.heading_deg"] = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
    values["sonar.roll_deg"] = float(np.rad2deg(np.arcsin(np.clip(left[2], -1, 1))))
    if frame.altitude_m is not None:
        values["sonar.altitude_m"] = float(frame.altitude_m + sonar[2, 3] - camera[2, 3])
    return values


def world_from_sonar(world_from_camera: Matrix, mount: Mount) -> Matrix:
    """(4, 4) pose of the sonar."""
    camera_from_sonar = np.eye(4)
    camera_from_sonar[:3, :3] = mount.rotation_sonar_from_camera().T
    camera_from_sonar[:3, 3] = mount.position_camera_m()
    return np.asarray(world_from_camera @ camera_from_sonar)


def _quaternion(rotation: Matrix) -> Matrix:
    """(4,) unit quaternion (x, y, z, w) of a rotation matrix, w not negative."""
    from scipy.spatial.transform import Rotation  # slow to import

    found = np.asarray(Rotation.from_matrix(rotation).as_quat(), np.float64)
    return -found if found[3] < 0 else found
