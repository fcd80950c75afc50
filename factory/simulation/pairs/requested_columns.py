"""The columns that `dataset.columns` asks for: pose, lens, calibration, boxes and tracks.

World axes are the recording's; of `scenes=seabed` z is up.  Camera axes: x right, y down, z
forward; sonar axes: x forward, y left, z up (REP 103).  A quaternion (x, y, z, w) turns directions
in the axes of the device into those of the world.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...common.array_types import Float64s
from ...dataset.meaning import class_names
from ...dataset.schema import Column
from ..frames.frame import Frame
from ..imaging.settings import is_coherent
from ..labels.boxes_column import BOXES, boxes_row
from ..labels.visibility import VISIBILITY
from ..moving.tracks import TRACKS, tracks_row
from ..render.base import Mount
from ..sonar.surface import LitSurface
from .sample_table import Row

if TYPE_CHECKING:
    from ..config.root import FactoryConfig

# NaN where the recording does not say.
_POSE = (
    *(
        Column(f"{device}.{name}", "f8", unit, f"of the {device}: {description}")
        for device in ("camera", "sonar")
        for name, unit, description in (
            *((f"{axis}_m", "m", f"position along the world's {axis}") for axis in "xyz"),
            *((f"q{part}", "1", f"quaternion to world axes, {part}") for part in "xyzw"),
        )
    ),
    Column("time_s", "f8", "s", "when the frame was taken, from any beginning"),
    Column("sonar.tilt_deg", "f8", "deg", "how far the sonar looks below the horizon"),
    Column("sonar.heading_deg", "f8", "deg", "where it looks, from the world's x towards its y"),
    Column("sonar.roll_deg", "f8", "deg", "how far its left side is up"),
    Column("sonar.altitude_m", "f8", "m", "height above the ground right under the camera"),
)
# The lens of the image in rgb and depth; distortion is 0 where it was taken out or is not known.
_LENS = tuple(
    Column(f"camera.{name}", "f8", unit, f"{description}, as OpenCV defines it")
    for name, unit, description in (
        ("fx_px", "px", "focal length across"),
        ("fy_px", "px", "focal length down"),
        ("cx_px", "px", "column of the principal point"),
        ("cy_px", "px", "row of the principal point"),
        ("k1", "1", "radial distortion r^2"),
        ("k2", "1", "radial distortion r^4"),
        ("p1", "1", "tangential distortion"),
        ("p2", "1", "tangential distortion"),
    )
)
# What turns grey values into sound pressure: level at the receiver = full scale of the image, its
# transfer curve backwards, less the gain, plus the source level; layer intensity_db is the result.
_CALIBRATION = (
    Column("source_level_db", "f8", "dB re 1 uPa at 1 m", "of the device"),
    Column("sound_speed_m_s", "f8", "m/s", "of the water"),
    Column("absorption_db_per_m", "f8", "dB/m", "of the water at the frequency, one way"),
    Column("tvg_db_per_decade", "f8", "dB", "time-varying gain of the pictures, per tenfold range"),
    Column("tvg_db_per_m", "f8", "dB/m", "time-varying gain of the pictures, per metre"),
)


def requested(names: Sequence[str]) -> tuple[Column, ...]:
    """Return the columns that `dataset.columns` asks for."""
    return tuple(column for name in names for column in _REQUESTABLE[name].columns)


def requested_row(lit: LitSurface, config: FactoryConfig) -> Row:
    """Return the values of `requested` for a frame as the sonar sees it."""
    row: Row = {}
    for name in config.dataset.columns:
        row |= _REQUESTABLE[name].row(lit, config)
    return row


def pose_row(frame: Frame, mount: Mount) -> Row:
    """Return the values of `pose` for a frame and the sonar mounted at its camera.

    NaN where the recording has no time, pose or altitude.
    """
    row: Row = dict.fromkeys((column.name for column in _POSE), float("nan"))
    if frame.time_s is not None:
        row["time_s"] = frame.time_s
    if frame.world_from_camera is None:
        return row

    world_from_camera = np.asarray(frame.world_from_camera, np.float64)
    camera_from_sonar = np.eye(4)
    camera_from_sonar[:3, :3] = mount.rotation_sonar_from_camera().T
    camera_from_sonar[:3, 3] = mount.position_camera_m()
    world_from_sonar = np.asarray(world_from_camera @ camera_from_sonar)
    pose_values = [*_position_and_quaternion(world_from_camera)]
    pose_values += _position_and_quaternion(world_from_sonar)
    row |= _row(_POSE[: len(pose_values)], *pose_values)

    forward = world_from_sonar[:3, 0]
    left = world_from_sonar[:3, 1]
    row["sonar.tilt_deg"] = float(np.rad2deg(np.arcsin(np.clip(-forward[2], -1, 1))))
    row["sonar.heading_deg"] = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
    row["sonar.roll_deg"] = float(np.rad2deg(np.arcsin(np.clip(left[2], -1, 1))))
    if frame.altitude_m is not None:
        sonar_up_m = world_from_sonar[2, 3]
        camera_up_m = world_from_camera[2, 3]
        row["sonar.altitude_m"] = float(frame.altitude_m + sonar_up_m - camera_up_m)
    return row


def _position_and_quaternion(pose: Float64s) -> list[float]:
    """Return x, y, z (metres) and the unit quaternion x, y, z, w of a (4, 4) pose, w >= 0."""
    from scipy.spatial.transform import Rotation  # slow to import

    quaternion = np.asarray(Rotation.from_matrix(pose[:3, :3]).as_quat(), np.float64)
    if quaternion[3] < 0:
        quaternion = -quaternion
    return [*pose[:3, 3].tolist(), *quaternion.tolist()]


def _lens_row(frame: Frame) -> Row:
    lens = frame.intrinsics
    no_distortion = (0.0, 0.0, 0.0, 0.0)
    values = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion, *no_distortion)
    return _row(_LENS, *map(float, values[: len(_LENS)]))


def _calibration_row(config: FactoryConfig) -> Row:
    sonar = config.sonar
    water = config.water
    acoustics = config.acoustics
    assert is_coherent(acoustics)  # the configuration refuses others
    absorption = water.absorption_db_per_m(sonar.frequency_khz)
    return _row(
        _CALIBRATION,
        sonar.array.source_level_db,
        water.sound_speed_m_s(),
        absorption,
        acoustics.tvg_log,
        2 * absorption if acoustics.tvg_absorption else 0.0,
    )


def _row(columns: Sequence[Column], *values: float | str) -> Row:
    return {column.name: value for column, value in zip(columns, values, strict=True)}


class Requestable(NamedTuple):
    """Columns that `dataset.columns` can ask for, and their values for a frame."""

    columns: tuple[Column, ...]
    row: Callable[[LitSurface, FactoryConfig], Row]


_REQUESTABLE: dict[str, Requestable] = {
    "pose": Requestable(_POSE, lambda lit, config: pose_row(lit.frame, config.sonar.mount)),
    "intrinsics": Requestable(_LENS, lambda lit, _: _lens_row(lit.frame)),
    "calibration": Requestable(_CALIBRATION, lambda _, config: _calibration_row(config)),
    "boxes": Requestable(
        BOXES,
        lambda lit, config: boxes_row(lit, class_names(config.scenes.own_classes())),
    ),
    # Its value depends on the noise of each image: see `pair_maker.make_pair`.
    "visibility": Requestable(VISIBILITY, lambda _, __: {"visibility": "{}"}),
    "tracks": Requestable(TRACKS, lambda lit, config: tracks_row(lit, config.sonar.frequency_khz)),
}
