"""Recorded paths of a camera: a pose a line, in the order of TUM's RGB-D sets."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..errors import FactoryError
from .base import numbered_lines

Pose = npt.NDArray[np.float64]


@lru_cache(maxsize=4)
def trajectory(path: Path) -> tuple[Pose, Pose]:
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
                "repair the line"
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
