"""A moving platform: its poses from a CSV file, relative to where its recording begins.

A line a frame, with a header that names the columns: any of `time_s`, `surge_m`, `sway_m`,
`heave_m`, `roll_deg`, `pitch_deg`, `yaw_deg`; what is not named is 0.  Surge is forward, sway to
the left, heave up (REP 103, level, along the first heading); yaw turns left, pitch looks down, roll
lowers the right side.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ..base import numbered_lines

COLUMNS = ("time_s", "surge_m", "sway_m", "heave_m", "roll_deg", "pitch_deg", "yaw_deg")
_MOST_FRAMES = 10_000
_MOST = 1e6

Points = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Movement:
    """One line of the file; the frame's time is None where the file has none."""

    time_s: float | None = None
    surge_m: float = 0.0
    sway_m: float = 0.0
    heave_m: float = 0.0
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0


@lru_cache(maxsize=4)
def movements(path: Path) -> tuple[Movement, ...]:
    """The movements of a file.  Raises FactoryError that names the file and the line."""
    lines = numbered_lines(path)
    rows = csv.reader(text for _, text in lines)
    names = [word.strip() for word in next(rows, [])]
    odd = [name for name in names if name not in COLUMNS]
    if not names or odd or len(set(names)) != len(names):
        raise FactoryError(
            f"{path}: expected a header of {', '.join(COLUMNS)} (some of them, each once), got "
            f"{','.join(names)[:60]!r}"
        )
    if not 1 <= len(lines) - 1 <= _MOST_FRAMES:
        raise FactoryError(
            f"{path}: {len(lines) - 1} frames; give a line for each of 1 to {_MOST_FRAMES}"
        )
    return tuple(
        _movement(path, number, names, row)
        for (number, _), row in zip(lines[1:], rows, strict=True)
    )


def _movement(path: Path, number: int, names: list[str], row: list[str]) -> Movement:
    try:
        values = [float(word) for word in row]
    except ValueError:
        values = []
    if len(values) != len(names) or not all(
        math.isfinite(value) and abs(value) <= _MOST for value in values
    ):
        raise FactoryError(
            f"{path}:{number}: expected {len(names)} numbers ({', '.join(names)}), got "
            f"{','.join(row)[:60]!r}"
        )
    return Movement(**dict(zip(names, values, strict=True)))


def moved(eye: Points, rotation: Points, by: Movement) -> tuple[Points, Points]:
    """Eye (3,) and rotation (3, 3; world from camera axes) after a movement.

    The camera's axes are x right, y down, z forward.
    """
    ahead = np.array([rotation[0, 2], rotation[1, 2], 0.0])
    ahead /= np.linalg.norm(ahead)
    left, up = np.array([-ahead[1], ahead[0], 0.0]), np.array([0.0, 0.0, 1.0])
    roll, pitch, yaw = np.deg2rad([by.roll_deg, by.pitch_deg, by.yaw_deg])
    turned = _about(up, yaw) @ rotation
    # Pitch about the camera's left, roll about its forward axis.
    turned = _about(-turned[:, 0], pitch) @ turned
    turned = _about(turned[:, 2], roll) @ turned
    return eye + by.surge_m * ahead + by.sway_m * left + by.heave_m * up, turned


def _about(axis: Points, angle_rad: float) -> Points:
    """Rotation matrix (3, 3) about a unit axis, right-handed (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turn = np.eye(3) + np.sin(angle_rad) * cross + (1 - np.cos(angle_rad)) * cross @ cross
    return np.asarray(turn)
