"""Recorded poses of a camera: text files with a line for each, in the order that a header states.

Without a header a line is `time tx ty tz qx qy qz qw` (TUM), seconds and metres.  A header names
the columns and their units, as EuRoC's and HoloOcean's files do:

    #timestamp [ns],p_x [m],p_y [m],p_z [m],q_w,q_x,q_y,q_z
"""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ...common.array_types import Float64s
from ...common.errors import FactoryError
from ...common.small_files import numbered_lines, numbers_in, text_lines

_COLUMNS = ("time", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_SECONDS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "ms": 1e-3, "s": 1.0, "sec": 1.0}
_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
# Seconds since 1970 until the year 5138; larger numbers count milliseconds or less.
_LATEST_S = 1e11
_TIME_NAME = re.compile(r"(?:time|timestamp|t|stamp)(?:_(?P<unit>ns|us|ms|s|sec))?")
_OFFSET_NAME = re.compile(r"(?:(?:t|p|pos|position|translation)_?(?:[a-z]+_)*)?(?P<axis>[xyz])")
_TURN_NAME = re.compile(r"(?:q|quat|quaternion|orientation)_?(?:[a-z]+_)*(?P<axis>[wxyz])")


PosesFrame = Literal["optical", "flu", "ned"]
"""Axes of the camera, or of the body that carries it, and of the world, in recorded poses.

optical: x right, y down, z forward; z of the world up.  flu: x forward, y left, z up; z of the
world up (ROS).  ned: x forward, y right, z down; z of the world down.
"""
# Columns: the optical axes in the axes of the body.
_OPTICAL_IN_BODY: dict[PosesFrame, Float64s] = {
    "optical": np.eye(3),
    "flu": np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
    "ned": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
}
# Turns a world whose z points down over: half a turn about x, which stays a turn.
_TURNED_OVER = np.diag([1.0, -1, -1, 1])


class _Column(NamedTuple):
    """What a column holds: a name of `_COLUMNS`, and the factor to seconds or metres."""

    name: str
    factor: float


@lru_cache(maxsize=4)
def optical_trajectory(path: Path, frame: PosesFrame) -> tuple[Float64s, Float64s]:
    """Times (N,) and poses (N, 4, 4), optical camera axes to a world whose z points up.

    Raises FactoryError as `trajectory` does.
    """
    times_s, stored = trajectory(path)
    return times_s, optical_poses(stored, frame)


def optical_poses(stored: Float64s, frame: PosesFrame) -> Float64s:
    """(N, 4, 4) poses of optical axes in a world whose z points up, of those in other axes."""
    poses = stored.copy()
    poses[:, :3, :3] = stored[:, :3, :3] @ _OPTICAL_IN_BODY[frame]
    return np.asarray(_TURNED_OVER @ poses) if frame == "ned" else poses


def axes_remark(frame: PosesFrame, forward: Float64s) -> str:
    """What a frame that sees nothing may owe to the axes of its pose.

    forward: (3,) unit vector along which the camera looks, z up.
    """
    x, y, z = forward
    others = {
        "optical": "scenes.poses_frame=flu or ned for poses of a body whose x points forward",
        "flu": "scenes.poses_frame=optical for a camera whose z points forward, ned for z down",
        "ned": "scenes.poses_frame=optical for a camera whose z points forward, flu for z up",
    }
    return (
        f"by scenes.poses_frame={frame} the camera looks along ({x:.2f}, {y:.2f}, {z:.2f}), z up; "
        f"set {others[frame]}"
    )


@lru_cache(maxsize=4)
def trajectory(path: Path) -> tuple[Float64s, Float64s]:
    """Times (N,) in seconds and poses (N, 4, 4), camera to world, of a file.

    Raises FactoryError that names file and line.
    """
    header = _header(path)
    lines = [line for line in numbered_lines(path) if header is None or line[0] != header.line]
    if not lines:
        raise FactoryError(f"{path}: no poses in it; expected lines of `{' '.join(_COLUMNS)}`")
    names = header.names if header else _COLUMNS
    table = np.array([numbers_in(path, line, names) for line in lines])
    if header:
        factors = {column.name: column.factor for column in header.columns.values()}
        indices = {column.name: index for index, column in header.columns.items()}
        table = np.stack([table[:, indices[name]] * factors[name] for name in _COLUMNS], axis=1)
    if np.abs(table[:, 0]).max() > _LATEST_S:
        raise FactoryError(
            f"{path}: time {table[0, 0]:.6g} s is no time in seconds; name its unit in a header, "
            f"such as `# timestamp [ns] {' '.join(_COLUMNS[1:])}`"
        )

    length = np.linalg.norm(table[:, 4:], axis=1, keepdims=True)
    if not length.all():
        number, line_text = lines[int(np.argmin(length))]
        raise FactoryError(f"{path}:{number}: expected a rotation, got {line_text[:60]!r}")
    return table[:, 0], pose_matrices(table[:, 1:4], table[:, 4:] / length)


def pose_matrices(positions_m: Float64s, quaternions: Float64s) -> Float64s:
    """(N, 4, 4) poses of positions (N, 3) and unit quaternions (N, 4), x, y, z, w."""
    poses = np.tile(np.eye(4), (len(positions_m), 1, 1))
    poses[:, :3, :3] = _rotations(quaternions)
    poses[:, :3, 3] = positions_m
    return poses


def _rotations(quaternions: Float64s) -> Float64s:
    """(N, 3, 3) of unit quaternions (N, 4) in the order x, y, z, w.

    R = (w^2 - a.a) I + 2 a a^T + 2 w [a]x, Rodrigues' formula for the quaternion (a, w).
    """
    axis, w = np.split(quaternions, [3], axis=1)
    outer = axis[:, :, None] * axis[:, None, :]
    cross = np.cross(axis[:, None, :], np.eye(3)[None], axisa=2, axisb=2)
    square = (w**2 - np.sum(axis**2, axis=1, keepdims=True))[:, :, None]
    rotations: Float64s = square * np.eye(3) + 2 * outer - 2 * w[:, :, None] * cross
    return rotations


class _Header(NamedTuple):
    """The header of a file of poses.

    line: its number.  names: names of all columns, as stated.  columns: index of each number of a
    pose.
    """

    line: int
    names: list[str]
    columns: dict[int, _Column]


def _header(path: Path) -> _Header | None:
    """The last line before the numbers, where it names the columns of a pose; else None.

    Raises FactoryError when it names some of them only, or units that are not known.
    """
    candidate: tuple[int, str] | None = None
    column_count = 0
    for line in text_lines(path):
        words = line[1].replace(",", " ").split()
        if _is_number(words[0]):
            column_count = len(words)
            break
        candidate = line
    if candidate is None:
        return None
    number, text = candidate
    names = _names(text.lstrip("#").strip())
    columns = {index: column for index, name in enumerate(names) if (column := _column(path, name))}
    found_names = [column.name for column in columns.values()]
    names_turn = any(name.startswith("q") for name in found_names)
    if not ({"tx", "ty", "tz"} <= set(found_names) and (names_turn or len(names) == column_count)):
        return None  # a remark
    missing = [name for name in _COLUMNS if name not in found_names]
    if missing or len(set(found_names)) < len(found_names):
        wrong = f"{', '.join(missing)} missing" if missing else "a column is there twice"
        raise FactoryError(
            f"{path}:{number}: header {text[:80]!r}: {wrong}; name the columns "
            f"{' '.join(_COLUMNS)} in any order"
        )
    return _Header(number, names, columns)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _names(text: str) -> list[str]:
    """Names of a header with their units in brackets, separated by commas or spaces."""
    if "," in text:
        return [name.strip() for name in text.split(",")]
    return re.findall(r"[^\s\[(]+(?:\s*[\[(][^\])]*[\])])?", text)


def _column(path: Path, stated: str) -> _Column | None:
    """What a stated name means; None for columns that are no part of a pose."""
    match = re.fullmatch(r"\s*([^\s\[(]+)\s*(?:[\[(]\s*([^\])]*?)\s*[\])])?\s*", stated)
    if match is None:
        return None
    name = match[1].strip("#").lower()
    unit = match[2]
    if time := _TIME_NAME.fullmatch(name):
        return _Column("time", _factor(path, stated, unit or time["unit"], _SECONDS))
    if turn := _TURN_NAME.fullmatch(name):
        return _Column(f"q{turn['axis']}", 1.0)
    if offset := _OFFSET_NAME.fullmatch(name):
        return _Column(f"t{offset['axis']}", _factor(path, stated, unit, _METRES))
    return None


def _factor(path: Path, stated: str, unit: str | None, units: dict[str, float]) -> float:
    if unit is None or unit == "":
        return 1.0
    if unit not in units:
        raise FactoryError(
            f"{path}: column {stated!r}: unit {unit!r} is none of {', '.join(units)}"
        )
    return units[unit]
