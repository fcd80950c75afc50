"""Camera trajectories that recordings carry: TUM ground truth and Redwood logs."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import FactoryError
from .roots import listing

Pose = npt.NDArray[np.float64]


def pose_at(path: Path, time_s: float, max_time_difference_s: float) -> Pose | None:
    """(4, 4) world-from-camera pose nearest in time in a TUM trajectory, None when none is near."""
    times, poses = _tum_trajectory(path)
    if times.size == 0:
        return None
    nearest = int(np.argmin(np.abs(times - time_s)))
    if abs(times[nearest] - time_s) > max_time_difference_s:
        return None
    return np.asarray(poses[nearest])


@lru_cache(maxsize=4)
def _tum_trajectory(path: Path) -> tuple[Pose, Pose]:
    """Times (N,) in seconds and poses (N, 4, 4) from `time tx ty tz qx qy qz qw` lines."""
    rows = []
    for number, line in numbered_lines(path):
        try:
            row = [float(word) for word in line.replace(",", " ").split()]
        except ValueError:
            row = []
        if len(row) != 8 or not np.isfinite(row).all() or not any(row[4:]):
            raise FactoryError(
                f"{path}:{number}: expected `time tx ty tz qx qy qz qw`, got {line[:60]!r}; "
                "repair the line, or remove the file to go without poses"
            )
        rows.append(row)
    table = np.array(rows, dtype=np.float64).reshape(-1, 8)
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, :3] = _rotations(table[:, 4:])
    poses[:, :3, 3] = table[:, 1:4]
    return table[:, 0], poses


def _rotations(quaternions_xyzw: Pose) -> Pose:
    """(N, 4) quaternions of any length but 0 -> (N, 3, 3) rotation matrices."""
    length = np.linalg.norm(quaternions_xyzw, axis=1, keepdims=True)
    axis, w = np.split(quaternions_xyzw / length, [3], axis=1)
    # R = (w^2 - a.a) I + 2 a a^T + 2 w [a]x  (Rodrigues' formula for the unit quaternion (a, w))
    outer = axis[:, :, None] * axis[:, None, :]
    cross = np.cross(axis[:, None, :], np.eye(3)[None], axisa=2, axisb=2)
    square = (w**2 - np.sum(axis**2, axis=1, keepdims=True))[:, :, None]
    return np.asarray(square * np.eye(3) + 2 * outer - 2 * w[:, :, None] * cross)


@lru_cache(maxsize=4)
def redwood_poses(path: Path) -> dict[int, Pose]:
    """Frame number -> (4, 4) world-from-camera pose.

    A record is five lines: three whole numbers, the first of which is the frame's, and the four
    rows of the matrix.
    """
    lines = list(numbered_lines(path))
    poses: dict[int, Pose] = {}
    for start in range(0, len(lines), 5):
        record = [line.split() for _, line in lines[start : start + 5]]
        try:
            pose = np.array(record[1:], dtype=np.float64).reshape(4, 4)
            if not np.isfinite(pose).all():
                raise ValueError
            poses[int(record[0][0])] = pose
        except (ValueError, IndexError) as error:
            raise FactoryError(
                f"{path}:{lines[start][0]}: expected a frame number line and four rows of a 4x4 "
                "pose; repair the file, or remove it to go without poses"
            ) from error
    return poses


def numbered_lines(path: Path) -> list[tuple[int, str]]:
    """(line number, text) of the lines that are neither empty nor comments (`#`).

    Raises UnreadableError when the file cannot be read, FactoryError when it is no text.
    """
    try:
        with listing(path):
            text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise FactoryError(f"{path}: not a text file; give the recording's own list") from error
    numbered = enumerate((line.strip() for line in text.splitlines()), start=1)
    return [(number, line) for number, line in numbered if line and not line.startswith("#")]
