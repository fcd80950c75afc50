"""Poses along a trajectory, with their times: lines of a file, or one of three shapes."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ...common.errors import FactoryError
from ..meshes.camera import MOVEMENT, movements
from ..scenes.poses import trajectory
from .pose import Pose

_LEG_M = 8.0  # of a lawnmower
_LEGS_APART_M = 1.5
_RADIUS_M = 3.0  # of a circle


class TimedPose(NamedTuple):
    """A pose, and seconds since the beginning of the trajectory."""

    time_s: float
    pose: Pose


def poses_of(
    name: str, scene: str, *, count: int, rate_hz: float, speed_m_s: float
) -> list[TimedPose]:
    """The poses of a trajectory.

    name: line, circle or lawnmower, or a file: of `scenes.path` for procedural places, of
        `scenes.poses` for meshes.  scene: kind of the scene.
    count, rate_hz, speed_m_s: of the shapes; a file without times is sailed at `rate_hz`.
    Raises FactoryError for a name that is neither, and a shape in a mesh.
    """
    if name in _SHAPES:
        if scene == "mesh":
            raise FactoryError(f"--path={name}: a mesh has no first pose; give a file of poses")
        return [
            TimedPose(number / rate_hz, _SHAPES[name](speed_m_s * number / rate_hz))
            for number in range(count)
        ]
    path = Path(name).expanduser()
    if not path.is_file():
        raise FactoryError(f"--path={name}: no such file; shapes are {', '.join(_SHAPES)}")
    return list(_recorded(path, rate_hz) if scene == "mesh" else _movements(path, rate_hz))


def _movements(path: Path, rate_hz: float) -> Iterator[TimedPose]:
    lines = movements(path)
    start_s = lines[0].get("time_s", 0.0)
    for number, line in enumerate(lines):
        time_s = line.get("time_s", start_s + number / rate_hz)
        moves: dict[str, Any] = {name: line[name] for name in MOVEMENT if name in line}
        yield TimedPose(time_s - start_s, Pose(**moves))


def _recorded(path: Path, rate_hz: float) -> Iterator[TimedPose]:
    from scipy.spatial.transform import Rotation  # slow to import

    times_s, poses = trajectory(path)
    for time_s, pose in zip(times_s.tolist(), poses, strict=True):
        x, y, z = pose[:3, 3].tolist()
        turn = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        yield TimedPose(
            time_s - float(times_s[0]), Pose(position_m=(x, y, z), quaternion=tuple(turn))
        )


def _line(travelled_m: float) -> Pose:
    return Pose(surge_m=travelled_m)


def _circle(travelled_m: float) -> Pose:
    """To the left."""
    angle_rad = travelled_m / _RADIUS_M
    return Pose(
        surge_m=_RADIUS_M * math.sin(angle_rad),
        sway_m=_RADIUS_M * (1 - math.cos(angle_rad)),
        yaw_deg=math.degrees(angle_rad),
    )


def _lawnmower(travelled_m: float) -> Pose:
    """Legs side by side to the left, half circles between them."""
    turn_m = math.pi * _LEGS_APART_M / 2
    leg, along_m = divmod(travelled_m, _LEG_M + turn_m)
    is_back = leg % 2 == 1
    angle_rad = max(along_m - _LEG_M, 0.0) / (_LEGS_APART_M / 2)
    side = -1 if is_back else 1
    beyond_m = _LEGS_APART_M / 2 * math.sin(angle_rad)
    surge_m = min(along_m, _LEG_M) + beyond_m
    return Pose(
        surge_m=_LEG_M - surge_m if is_back else surge_m,
        sway_m=leg * _LEGS_APART_M + _LEGS_APART_M / 2 * (1 - math.cos(angle_rad)),
        yaw_deg=180.0 * is_back + side * math.degrees(angle_rad),
    )


_SHAPES: dict[str, Callable[[float], Pose]] = {
    "line": _line,
    "circle": _circle,
    "lawnmower": _lawnmower,
}
